"""An executor over Ray; needs the extra ``ray``."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any

from dappo_batch._extras import missing

try:
    import ray
except ImportError as error:
    raise missing("ray", ["ray"], "executors of this kind") from error

__all__ = ["RayExecutor"]


class RayExecutor(Executor):
    """Runs calls as tasks of a Ray cluster, again on another node when theirs is lost.

    Parameters
    ----------
    cpus
        Cores that Ray sets aside for a call.
    gpus
        The same for GPUs.
    retries
        How often a call whose node or process was lost is run again; -1 for ever. Calls that raise are not.

    Notes
    -----
    ``ray.init`` is the program's own business. Nodes must see the same folders. Ray counts cores but holds
    no call to them: give the trainings ``threads`` that fit `cpus`.
    """

    def __init__(self, *, cpus: float = 1.0, gpus: float = 0.0, retries: int = 10) -> None:
        self._options = {"num_cpus": cpus, "num_gpus": gpus, "max_retries": retries}
        self._tasks: list[Any] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:  # noqa: ANN401
        """Start a call as a task."""
        task = ray.remote(fn).options(**self._options).remote(*args, **kwargs)
        self._tasks.append(task)
        future: Future[Any] = task.future()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Wait for the tasks, or cancel those that have not ended; the cluster stays as it is."""
        if cancel_futures:
            for task in self._tasks:
                ray.cancel(task)
        if wait and self._tasks:
            ray.wait(self._tasks, num_returns=len(self._tasks))
