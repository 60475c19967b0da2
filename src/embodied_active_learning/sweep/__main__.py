"""Make all runs of a sweep: worlds x seeds x variants, in worker processes or on a cluster.

    python3 -m embodied_active_learning.sweep SPEC.yaml [--workers 2] [--dry-run]

It can be interrupted at any time: started again, it continues each run at its checkpoint. The record of each run, some
tens of kilobytes of CSV, is stored in results/NAME beside the file of the sweep; a run with a record is not repeated.
"""

from __future__ import annotations

import argparse
import os
import signal
import statistics
import sys
from pathlib import Path
from typing import Any, Dict, List, Sequence, Tuple

from embodied_active_learning.config import Config
from embodied_active_learning.errors import EmbodiedActiveLearningError
from embodied_active_learning.files import parse_yaml
from embodied_active_learning.pipeline.progress import duration
from embodied_active_learning.session.disk import free_bytes
from embodied_active_learning.sweep.jobs import Job
from embodied_active_learning.sweep.run_records import load_record
from embodied_active_learning.sweep.runner import CLUSTERS, PROCESSES, make_runs, threads_per_worker
from embodied_active_learning.sweep.spec import check_worlds, load_sweep


def main(arguments: Sequence[str]) -> int:
    """Make the runs. Return 0 if all are complete, 1 if some failed, 2 if the sweep is invalid, 130 if interrupted."""
    options = _parse(arguments)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        jobs, folder = _jobs(options)
        if options.dry_run:
            _print(_plan(jobs, folder, options.workers))
            return 0
        errors = make_runs(jobs, options.workers, _print, options.executor, options.set, folder / "jobs")
    except EmbodiedActiveLearningError as error:
        print(error, file=sys.stderr)  # noqa: T201 - a command
        return 2
    except KeyboardInterrupt:
        print("interrupted: the same command continues the sweep", file=sys.stderr)  # noqa: T201
        return 130
    _print(f"{len(jobs) - len(errors)} of {len(jobs)} runs completed; records: {jobs[0].records}")
    return 1 if errors else 0


def _parse(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="sweep", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("spec", type=Path, help="YAML file of the sweep, such as experiments/learning_metrics.yaml")
    parser.add_argument("--workers", type=int, default=1, help="runs at the same time")
    parser.add_argument(
        "--root",
        type=Path,
        default=Path(Config().session.root) / "sweeps",
        help="folder of the sessions, below the sweep's name (default: %(default)s)",
    )
    parser.add_argument("--results", type=Path, help="folder of the records (default: results/NAME beside the file)")
    parser.add_argument(
        "--executor", choices=(PROCESSES, *CLUSTERS), default=PROCESSES, help="worker processes, or one of submitit's"
    )
    parser.add_argument(
        "--set",
        nargs="*",
        default={},
        action=_Pairs,
        metavar="KEY=VALUE",
        help="parameters of submitit, such as slurm_partition=short timeout_min=600",
    )
    parser.add_argument("--dry-run", action="store_true", help="list runs, disk and time needed, and make none")
    options = parser.parse_args(arguments)
    if options.workers < 1:
        parser.error("--workers must be at least 1")
    return options


class _Pairs(argparse.Action):
    """Collects KEY=VALUE as a dictionary."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: Any = None) -> None:
        pairs: Dict[str, Any] = {}
        for text in values:
            key, equals, value = text.partition("=")
            if not equals:
                parser.error(f"{option_string}: {text!r} is malformed: expected KEY=VALUE")
            try:
                pairs[key] = parse_yaml(value)
            except ValueError as error:
                parser.error(f"{option_string}: {key} is malformed: {error}")
        setattr(namespace, self.dest, pairs)


def _jobs(options: argparse.Namespace) -> Tuple[List[Job], Path]:
    """Return the jobs and the sweep's folder of sessions."""
    sweep = load_sweep(options.spec)
    check_worlds(sweep)
    folder = Path(os.path.abspath(options.root.expanduser())) / sweep.name
    records = options.results or options.spec.parent / "results" / sweep.name
    threads = threads_per_worker(options.workers)
    return [Job(run, folder, Path(os.path.abspath(records)), threads) for run in sweep.runs], folder


def _plan(jobs: Sequence[Job], folder: Path, workers: int) -> str:
    """Return a line for each run, and the disk and the time that the missing ones need."""
    lines, rates, left = [], [], 0.0
    for job in jobs:
        job.check()
        progress = job.progress()
        state = "completed" if job.complete else f"{progress.step} of {progress.steps} steps"
        lines.append(f"{job.run.name}: {state}")
        if job.complete:
            record = load_record(job.record)
            if not record.failure:  # a run that diverged has not made all its steps
                rates.append(record.summary.wall_time / max(1, record.summary.steps))
        else:
            left += (1.0 - progress.share) * progress.steps
    time = duration(left * statistics.median(rates) / workers) if rates else "unknown until a run is complete"
    needed, free = sum(job.bytes_needed() for job in jobs) / 1e9, free_bytes(folder) / 1e9
    lines.append(f"disk: {needed:.1f} GB needed in {folder}, {free:.1f} GB free; time with {workers} workers: {time}")
    return "\n".join(lines)


def _print(line: str) -> None:
    print(line, flush=True)  # noqa: T201 - a command


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
