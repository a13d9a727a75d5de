"""An executor over Slurm with submitit; needs the extra ``slurm``."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from os import PathLike, fspath
from threading import Thread
from typing import Any

from dappo_batch._extras import missing

try:
    import submitit
except ImportError as error:
    raise missing("slurm", ["submitit"], "executors of this kind") from error

__all__ = ["SlurmExecutor"]


class SlurmExecutor(Executor):
    """Runs each call as a separate job.

    Parameters
    ----------
    folder
        Folder for submitit's scripts, logs and results; every node needs access to it.
    cluster
        ``slurm``, or ``local`` for processes on this machine; by default Slurm if it is installed.
    **parameters
        Parameters of submitit: ``timeout_min``, ``slurm_partition``, ``cpus_per_task``, … If Slurm does not
        limit jobs to their cores, set ``threads`` of the trainings accordingly.
    """

    def __init__(
        self,
        folder: str | PathLike[str],
        *,
        cluster: str | None = None,
        **parameters: Any,  # noqa: ANN401 - submitit's own
    ) -> None:
        self._executor = submitit.AutoExecutor(fspath(folder), cluster=cluster)
        self._executor.update_parameters(**parameters)
        self._jobs: list[submitit.Job[Any]] = []
        self._waiters: list[Thread] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:  # noqa: ANN401
        """Start a call as a job."""
        job = self._executor.submit(fn, *args, **kwargs)
        future: Future[Any] = Future()
        future.set_running_or_notify_cancel()
        waiter = Thread(target=_wait, args=(job, future), daemon=True)
        waiter.start()
        self._jobs.append(job)
        self._waiters.append(waiter)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Wait for the jobs, or cancel those that have not ended."""
        if cancel_futures:
            for job in self._jobs:
                job.cancel()
        if wait:
            for waiter in self._waiters:
                waiter.join()


def _wait(job: submitit.Job[Any], future: Future[Any]) -> None:
    """Copy the outcome of a job to a future, as submitit cannot wait for several jobs."""
    try:
        future.set_result(job.result())
    except BaseException as error:  # any exception of the job
        future.set_exception(error)
