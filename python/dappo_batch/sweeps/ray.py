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
    """Runs calls as tasks of a Ray cluster, and repeats them on another node if theirs is lost.

    Parameters
    ----------
    cpus
        Cores that Ray reserves for a call.
    gpus
        The same for GPUs.
    retries
        How often a call is repeated whose node or process was lost; -1 without limit. Exceptions are not
        retried.

    Notes
    -----
    The program calls ``ray.init``. All nodes need access to the same folders. Ray does not limit calls to
    their reserved cores: set ``threads`` of the trainings accordingly.
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
        """Wait for the tasks, or cancel those that have not ended; the cluster keeps running."""
        if cancel_futures:
            for task in self._tasks:
                ray.cancel(task)
        if wait and self._tasks:
            ray.wait(self._tasks, num_returns=len(self._tasks))
