#!/usr/bin/env python3
"""Measure several trainers on this computer: quality at equal total updates, and kills of workers.

    python3 experiments/trainers.py quality --session recorded --trainers 1 2 4 --rounds 1 5 25 100 --seeds 1 2
    python3 experiments/trainers.py kills --kills 200

`quality` repeats only the training: it hands over the observations of a session again. Rows are appended to
experiments/results/trainers/quality.csv and kills.csv; quality skips rows that are there already.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import random
import resource
import signal
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Dict

import numpy as np
import torch

import embodied_active_learning as eal
from embodied_active_learning.config import Config
from embodied_active_learning.distributed.local import start_workers
from embodied_active_learning.distributed.worker import serve_until_end
from embodied_active_learning.pipeline.fingerprinting import FingerprintRun
from embodied_active_learning.pipeline.learning import BackgroundTraining
from embodied_active_learning.pipeline.training import TrainingRun
from embodied_active_learning.session.session import Session
from embodied_active_learning.sweep.csv_files import append_rows, read_rows

RESULTS = Path(__file__).resolve().parent / "results" / "trainers"


def cpu_seconds() -> float:
    """Return the processor time of this process and of its children that have ended."""
    kinds = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return sum(kind.ru_utime + kind.ru_stime for kind in kinds)


def with_training(config: Config, root: str, seed: int, steps: int, **training: Any) -> Config:
    """Return a configuration for a new session in a folder, with other settings of the training."""
    return replace(
        config,
        training=replace(config.training, threads=1, device="cpu", worker_timeout=600.0, **training),
        exploration=replace(config.exploration, seed=seed, steps=steps),
        session=replace(config.session, name="run", root=root, resume=False),
    )


def train(run: TrainingRun, trainers: int) -> None:
    """Train until all updates are made, with workers on this computer."""
    if run.pool is None:
        run.train(lambda report: None, run.stop)
        return
    with start_workers(trainers - 1, run.pool.address):
        run.train(lambda report: None, run.stop)


def measure_quality(stored: Session, steps: int, trainers: int, updates_per_round: int, seed: int) -> Dict[str, Any]:
    """Train on the observations of a session; return a row of QUALITY."""
    with tempfile.TemporaryDirectory() as root, stored.open_observations() as store:
        config = with_training(stored.config, root, seed, steps, trainers=trainers, updates_per_round=updates_per_round)
        run = TrainingRun(config)
        for index in range(config.exploration.steps):
            run.observe(index, float(store.stamps[index]), store.raw_states[index].tolist(), store.images[index])
        began, spent = time.monotonic(), cpu_seconds()
        train(run, trainers)
        seconds, spent = time.monotonic() - began, cpu_seconds() - spent
        run.close()
        session = Session.open_read_only(run.folder)
        training, evaluation = session.read_table("training"), session.read_table("evaluation")
        rounds = session.read_table("rounds")
        last = training["update"] > 0.9 * training["update"][-1]
        return {
            "trainers": trainers,
            "updates_per_round": updates_per_round if trainers > 1 else 0,
            "seed": seed,
            "updates": run.updates,
            "loss": float(training["loss"][last].mean()),
            **{name: float(evaluation[name][-1]) for name in ("mse_own", "mse_none")},
            "active_units": int(evaluation["active_units"][-1]),
            "objects": len(FingerprintRun(run.folder, from_stored=True).names),
            "seconds": seconds,
            "cpu_seconds": spent,
            "computing": float(rounds["computing"].sum() / rounds["seconds"].sum()) if len(rounds["seconds"]) else 1.0,
        }


def quality(options: argparse.Namespace) -> None:
    """Measure all combinations that are not in the table yet."""
    path, stored = options.output or RESULTS / "quality.csv", eal.load_session(options.session)
    if stored.config.training.updates_per_observation == 0:
        raise SystemExit(f"{stored.name} was recorded with training/updates_per_observation 0: nothing to train")
    done = {(row["trainers"], row["updates_per_round"], row["seed"]) for row in read_rows(path, missing_ok=True)}
    for seed in options.seeds:
        for trainers in options.trainers:
            for updates in options.rounds if trainers > 1 else [0]:
                if (str(trainers), str(updates), str(seed)) not in done:
                    store(path, measure_quality(stored, options.steps, trainers, max(1, updates), seed))


class RandomFaults:
    """Keeps workers running in processes of their own, and kills or freezes one of them now and then."""

    def __init__(self, count: int, owner: str, seed: int) -> None:
        self._random = random.Random(seed)
        self._start = multiprocessing.get_context("forkserver").Process
        self._owner = owner
        self._workers = [self._started() for _ in range(count)]
        self.kills = self.freezes = 0

    def strike(self) -> None:
        """Kill a worker and start another, or freeze one for up to three seconds."""
        time.sleep(self._random.uniform(0.0, 1.0))
        victim = self._random.randrange(len(self._workers))
        process = self._workers[victim]
        if self._random.random() < 0.8:
            process.kill()
            process.join()
            self._workers[victim] = self._started()
            self.kills += 1
        else:
            os.kill(process.pid, signal.SIGSTOP)
            time.sleep(self._random.uniform(0.0, 3.0))
            os.kill(process.pid, signal.SIGCONT)
            self.freezes += 1

    def close(self) -> None:
        """End all workers."""
        for process in self._workers:
            process.kill()
            process.join()

    def _started(self) -> Any:
        process = self._start(target=serve_until_end, args=(self._owner, "127.0.0.1"))
        process.start()
        return process


def small(root: str, seed: int) -> Config:
    """Return the configuration of a run with small images that takes about half a minute."""
    return Config.from_dict(
        {
            "camera": {"width": 24, "height": 24},
            "model": {"latent_size": 4, "hidden_sizes": [64], "channels": [4], "kernels": [3], "strides": [3]},
            "training": {
                "batch_size": 16,
                "first_update_at": 16,
                "device": "cpu",
                "threads": 1,
                "trainers": 4,
                "updates_per_round": 5,
                "worker_timeout": 1.0,
            },
            "exploration": {"steps": 600, "seed": seed},
            "session": {"name": "run", "root": root},
        }
    )


def measure_kills(seed: int, limit: int) -> Dict[str, Any]:
    """Train while workers are killed and frozen, at most `limit` kills; return a row of KILLS."""
    draws = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as root:
        config = small(root, seed)
        steps = config.exploration.steps
        states = draws.uniform([0.33, -0.14, -1.9], [0.62, 0.14, 1.9], (steps, 3))
        images = draws.integers(0, 256, (steps, 24, 24, 3), dtype=np.uint8)
        began = time.monotonic()
        with BackgroundTraining(config, local_workers=False) as training:
            run = training.run
            faults = RandomFaults(3, run.pool.address, seed)
            for index in range(steps):
                run.observe(index, 0.05 * index, states[index].tolist(), images[index])
                time.sleep(0.05)
                if index % 20 == 19 and faults.kills < limit:
                    faults.strike()
            while not run.finished:
                training.check()
                time.sleep(0.05)
            faults.close()
        session = Session.open_read_only(run.folder)
        rounds, updates = session.read_table("rounds"), session.read_table("training")["update"]
        with session.open_observations() as store:
            kept = (
                len(store) == steps and np.array_equal(store.images, images) and np.allclose(store.raw_states, states)
            )
            lost = 0 if kept else steps - len(store)
        planned = config.update_plan.total
        return {
            "seed": seed,
            "kills": faults.kills,
            "freezes": faults.freezes,
            "observations": steps,
            "lost": lost,
            "intact": kept,
            "updates": int(rounds["updates"].sum()),
            "planned": planned,
            "rows_in_order": bool((np.diff(updates) > 0).all()),
            "rounds": len(rounds["update"]),
            "with_all_trainers": int((rounds["trainers"] == 4).sum()),
            "longest_round": float(rounds["seconds"].max()),
            "seconds": time.monotonic() - began,
        }


def kills(options: argparse.Namespace) -> None:
    """Measure runs until the table has the wanted number of kills."""
    path = options.output or RESULTS / "kills.csv"
    while True:
        made = read_rows(path, missing_ok=True)
        left = options.kills - sum(int(row["kills"]) for row in made)
        if left <= 0:
            return
        store(path, measure_kills(1 + len(made), left))


def store(path: Path, row: Dict[str, Any]) -> None:
    """Append a row to a CSV file, and print it."""
    append_rows(path, [row])
    print(row, flush=True)


def main() -> None:
    """Measure."""
    torch.set_num_threads(1)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    command = commands.add_parser("quality")
    command.add_argument("--session", required=True, help="name or folder of a session with observations")
    command.add_argument("--steps", type=int, default=400, help="number of its observations to use")
    command.add_argument("--trainers", nargs="+", type=int, default=[1, 2, 4])
    command.add_argument("--rounds", nargs="+", type=int, default=[1, 5, 25, 100], help="updates_per_round")
    command.add_argument("--seeds", nargs="+", type=int, default=[1])
    command.add_argument("--output", type=Path)
    command.set_defaults(run=quality)
    command = commands.add_parser("kills")
    command.add_argument("--kills", type=int, default=200)
    command.add_argument("--output", type=Path)
    command.set_defaults(run=kills)
    multiprocessing.set_forkserver_preload(["__main__"])
    options = parser.parse_args()
    options.run(options)


if __name__ == "__main__":
    main()
