"""Makes the runs of a sweep in worker processes of this computer, or as jobs of a cluster through submitit."""

from __future__ import annotations

import concurrent.futures
import multiprocessing
import os
import signal
import time
from contextlib import nullcontext
from multiprocessing.connection import Connection
from pathlib import Path
from types import MappingProxyType
from typing import Any, Callable, ContextManager, Dict, List, Mapping, Sequence, Tuple

from embodied_active_learning.errors import ConfigError, CorruptFileError, MissingPackageError, SessionError
from embodied_active_learning.pipeline.progress import Progress, TimeLeft, duration
from embodied_active_learning.session.atomic import make_folder
from embodied_active_learning.sweep.jobs import Job

PROCESSES = "processes"
CLUSTERS = ("slurm", "local")
"""Executors of submitit; local starts all runs at once, without a cluster."""
_POLL_PERIOD, _REPORT_PERIOD = 0.2, 30.0  # s
_ESTIMATES = 60
"""Reports that the remaining time is estimated from."""
_LIBRARY_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def make_runs(
    jobs: Sequence[Job],
    workers: int,
    report: Callable[[str], None],
    executor: str = PROCESSES,
    options: Mapping[str, Any] = MappingProxyType({}),
    folder: Path = Path("jobs"),
) -> Dict[str, str]:
    """Make all runs that have no record yet. Interrupted by an exception, it ends them at a checkpoint.

    Args:
        jobs: The runs, in the order in which they are started.
        workers: Runs at the same time.
        report: Called with a line after each run, and regularly in between.
        executor: "processes" for worker processes, or the name of one of submitit's executors.
        options: Parameters of submitit, such as slurm_partition.
        folder: Where submitit stores jobs and logs.

    Returns:
        The errors of failed runs by name; they can be made again.

    Raises:
        SessionError: A stored run was made with other settings.
        ConfigError: submitit rejected a parameter.
        MissingPackageError: submitit is not installed.
    """
    for job in jobs:
        job.check()
    left = [job for job in jobs if not job.complete]
    pool = _Processes(workers) if executor == PROCESSES else _cluster(executor, workers, left, options, folder)
    time_left = TimeLeft(window=_ESTIMATES)
    pending: List[Tuple[Job, Any]] = []
    try:
        with pool.batch():
            pending = [(job, pool.submit(job)) for job in left]
        return _wait(jobs, pending, report, time_left)
    finally:
        for _, future in pending:
            if not future.done():
                future.cancel()
        if isinstance(pool, _Processes):
            pool.end()


def total_progress(jobs: Sequence[Job]) -> Progress:
    """Return the sum of the progress of all runs; one whose tables are damaged counts as not started.

    Such a run fails with the reason when it is continued.
    """
    parts = []
    for job in jobs:
        try:
            parts.append(job.progress())
        except CorruptFileError:
            config = job.run.config
            parts.append(Progress(0, config.exploration.steps, 0, config.update_plan.total))
    return Progress(
        step=sum(part.step for part in parts),
        steps=sum(part.steps for part in parts),
        updates=sum(part.updates for part in parts),
        updates_planned=sum(part.updates_planned for part in parts),
    )


def _wait(
    jobs: Sequence[Job], pending: List[Tuple[Job, Any]], report: Callable[[str], None], time_left: TimeLeft
) -> Dict[str, str]:
    """Report finished runs and the overall progress until nothing is pending. Return the errors."""
    errors: Dict[str, str] = {}
    waiting, next_report = list(pending), 0.0
    while waiting:
        if time.monotonic() >= next_report:
            report(_line(jobs, time_left))
            next_report = time.monotonic() + _REPORT_PERIOD
        ended = [item for item in waiting if item[1].done()]
        for job, future in ended:
            try:
                report(future.result())
            except Exception as error:  # of any kind, from another process; the other runs continue
                errors[job.run.name] = str(error)
                report(f"{job.run.name}: failed: {error}")
        waiting = [item for item in waiting if item not in ended]
        if not ended:
            time.sleep(_POLL_PERIOD)
    return errors


def _line(jobs: Sequence[Job], time_left: TimeLeft) -> str:
    made, progress = sum(job.complete for job in jobs), total_progress(jobs)
    return (
        f"runs {made}/{len(jobs)}  steps {progress.step}/{progress.steps}  "
        f"updates {progress.updates}/{progress.updates_planned}  left {duration(time_left.estimate(progress.share))}"
    )


def _run_in_process(job: Job) -> str:
    """Make a run in a process of its own, which a crash ends alone. Return its line. Raises SessionError."""
    context = multiprocessing.get_context("spawn")  # torch and PyBullet hold threads, which must not be forked
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(job, sender), name=job.run.name)
    process.start()
    sender.close()
    try:
        line, error = receiver.recv()
    except EOFError:
        line, error = "", "its process was killed or has crashed; it can be continued"
    process.join()
    if error:
        raise SessionError(error)
    return str(line)


def _work(job: Job, sender: Connection) -> None:
    """Make a run and send its line or its error. The parent passes interruptions on, once, as SIGTERM."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        sender.send((job(), ""))
    except KeyboardInterrupt:
        sender.send(("", "interrupted; it can be continued"))
    except Exception as error:  # of any kind: the other runs continue
        sender.send(("", f"{type(error).__name__}: {error}"))


def _interrupt(number: int, frame: object) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise KeyboardInterrupt


class _Processes:
    """Worker processes with the interface of submitit's executors."""

    def __init__(self, workers: int) -> None:
        for name in _LIBRARY_THREADS:
            os.environ.setdefault(name, str(threads_per_worker(workers)))
        self._pool = concurrent.futures.ThreadPoolExecutor(workers)

    def submit(self, job: Job) -> concurrent.futures.Future:
        """Queue a run."""
        return self._pool.submit(_run_in_process, job)

    def batch(self) -> ContextManager[None]:
        """Return a context in which runs are submitted together."""
        return nullcontext()

    def end(self) -> None:
        """End running processes at a checkpoint, after pending runs were cancelled."""
        for process in multiprocessing.active_children():
            process.terminate()
        self._pool.shutdown()


def _cluster(executor: str, workers: int, jobs: Sequence[Job], options: Mapping[str, Any], folder: Path) -> Any:
    """Return an executor of submitit."""
    try:
        import submitit  # noqa: PLC0415 - optional
    except ImportError as error:
        raise MissingPackageError(
            f"the executor {executor} needs submitit, which is not installed: pip install submitit"
        ) from error
    make_folder(folder)
    cluster = submitit.AutoExecutor(folder=str(folder), cluster=executor)
    threads = max((job.threads for job in jobs), default=1)
    defaults = {"name": "sweep", "cpus_per_task": threads, "slurm_array_parallelism": workers}
    try:
        cluster.update_parameters(**{**defaults, **options})
    except (AssertionError, NameError, TypeError, ValueError) as error:
        raise ConfigError(f"submitit rejected the parameters {dict(options)}: {error}") from error
    return cluster


def threads_per_worker(workers: int) -> int:
    """Return the cores of this computer that each worker may use."""
    return max(1, (os.cpu_count() or 1) // workers)
