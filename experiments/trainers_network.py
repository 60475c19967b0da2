#!/usr/bin/env python3
"""Measure several trainers on a slow network: rounds of local updates beside synchronous averaging.

    python3 experiments/trainers_network.py --rates 1000 100 --updates 0 5 25

Each trainer runs in a network namespace of its own, and `tc` limits all links. Synchronous averaging is an all-reduce
after each update (`--updates 0`), what DistributedDataParallel does without overlap. Rows are appended to
experiments/results/trainers/network.csv. Batches are small: the time of transfers does not depend on them. Needs root.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from contextlib import ExitStack
from datetime import timedelta
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Dict, List

import numpy as np
import torch
from torch import distributed
from trainers import store

from embodied_active_learning.config import Config
from embodied_active_learning.model.learner import Learner
from embodied_active_learning.pipeline.training import TrainingRun
from embodied_active_learning.session.session import Session

sys.path.append(str(Path(__file__).resolve().parents[1] / "test" / "support"))

from hosts import Hosts, connected_hosts, why_not

TRAINERS = 4
OBSERVATIONS = 16
ADDRESSES = {f"trainer{number}": f"10.77.0.{number + 1}" for number in range(TRAINERS)}
TIMEOUT = 600.0  # s


def configured(root: str, updates_per_round: int, rounds: int) -> Config:
    """Return the configuration of a run with the default model and small batches."""
    updates = TRAINERS * updates_per_round * rounds
    return Config.from_dict(
        {
            "training": {
                "batch_size": 8,
                "first_update_at": OBSERVATIONS,
                "updates_per_observation": -(-updates // OBSERVATIONS),
                "threads": 1,
                "device": "cpu",
                "trainers": TRAINERS,
                "updates_per_round": updates_per_round,
                "worker_timeout": TIMEOUT,
            },
            "exploration": {"steps": OBSERVATIONS},
            "session": {"name": "run", "root": root},
        }
    )


class RandomObservations:
    """Observations without content."""

    def __init__(self, config: Config) -> None:
        draws = np.random.default_rng(0)
        box, shape = config.workspace.box(), (config.camera.height, config.camera.width, 3)
        self.raw_states = draws.uniform(box.lower, box.upper, (OBSERVATIONS, 3))
        self.states = box.normalise(self.raw_states).astype(np.float32)
        self.images = draws.integers(0, 256, (OBSERVATIONS, *shape), dtype=np.uint8)

    def __len__(self) -> int:
        return OBSERVATIONS


def own_rounds(config: Config) -> None:
    """Train as the owner; print where workers join, then the rounds as JSON."""
    observations = RandomObservations(config)
    run = TrainingRun(config, ADDRESSES["trainer0"])
    print(run.pool.address if run.pool else "", flush=True)
    for index in range(OBSERVATIONS):
        run.observe(index, 0.2 * index, observations.raw_states[index].tolist(), observations.images[index])
    run.train(lambda report: None, run.stop)
    run.close()
    rounds = Session.open_read_only(run.folder).read_table("rounds")
    print(json.dumps({name: values.tolist() for name, values in rounds.items()}), flush=True)


def average_synchronously(config: Config, rank: int, rounds: int) -> None:
    """Make updates, and average the weights of all trainers after each; the first prints the times as JSON."""
    print(flush=True)  # others may start
    where: Any = {"init_method": f"tcp://{ADDRESSES['trainer0']}:29500", "timeout": timedelta(seconds=TIMEOUT)}
    distributed.init_process_group("gloo", rank=rank, world_size=TRAINERS, **where)
    learner = Learner(config, RandomObservations(config), config.exploration.seed)
    learner.reseed(rank)
    measured: Dict[str, List[float]] = {"seconds": [], "computing": [], "trainers": []}
    for number in range(rounds):
        distributed.barrier()
        began = time.monotonic()
        learner.step(number, beta=1e-4, gamma=0.1)
        weights = learner.weights()
        computed = time.monotonic()
        distributed.all_reduce(weights)
        learner.load_weights(weights / TRAINERS)
        measured["seconds"].append(time.monotonic() - began)
        measured["computing"].append(computed - began)
        measured["trainers"].append(TRAINERS)
    if rank == 0:
        print(json.dumps(measured), flush=True)


def measure(hosts: Hosts, updates_per_round: int, rounds: int) -> Dict[str, Any]:
    """Run all trainers; return medians over all rounds but the first. updates_per_round: 0 to average synchronously."""
    variables = {**os.environ, "GLOO_SOCKET_IFNAME": "eth0", "OMP_NUM_THREADS": "1"}
    with ExitStack() as running, TemporaryDirectory() as root:

        def start(host: str, *words: object) -> Any:
            command = hosts.command(host, sys.executable, *words)
            process = subprocess.Popen(command, env=variables, stdout=subprocess.PIPE, text=True)
            running.callback(process.wait)
            running.callback(process.kill)
            return process

        inside = [Path(__file__).resolve(), "--root", root, "--updates", updates_per_round, "--count", rounds, "--rank"]
        first, *others = ADDRESSES
        owner = start(first, *inside, 0)
        address = owner.stdout.readline().strip()
        for rank, host in enumerate(others, start=1):
            worker = ["-m", "embodied_active_learning.distributed.worker", address, ADDRESSES[host]]
            start(host, *(worker if updates_per_round else [*inside, rank]))
        output, _ = owner.communicate(timeout=TIMEOUT)
    found = json.loads(output)
    whole = [index for index, trainers in enumerate(found["trainers"]) if trainers == TRAINERS][1:rounds]
    seconds, computing = ([found[name][index] for index in whole] for name in ("seconds", "computing"))
    return {
        "averaging": "rounds" if updates_per_round else "synchronous",
        "updates_per_round": max(1, updates_per_round),
        "rounds": len(whole),
        "seconds": statistics.median(seconds),
        "computing": statistics.median(computing),
        "transfers": statistics.median(total - own for total, own in zip(seconds, computing)),
    }


def main() -> None:
    """Measure all combinations, or with --rank be one of the trainers."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rates", nargs="+", type=int, default=[1000, 100], help="of the links, Mb/s")
    parser.add_argument("--updates", nargs="+", type=int, default=[0, 5, 25], help="per round; 0: synchronous")
    parser.add_argument("--count", type=int, default=4, help="rounds; the first is not measured")
    parser.add_argument(
        "--output", type=Path, default=Path(__file__).resolve().parent / "results" / "trainers" / "network.csv"
    )
    parser.add_argument("--rank", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--root", help=argparse.SUPPRESS)
    options = parser.parse_args()
    torch.set_num_threads(1)
    if options.rank is not None:
        config = configured(options.root, max(1, options.updates[0]), options.count)
        if options.updates[0]:
            own_rounds(config)
        else:
            average_synchronously(config, options.rank, options.count)
        return
    reason = why_not()
    if reason:
        sys.exit(f"not measured: {reason}; run it as root, with iproute2")
    for rate in options.rates:
        with connected_hosts(ADDRESSES) as hosts:
            hosts.limit(rate)
            for updates in options.updates:
                store(options.output, {"rate": rate, **measure(hosts, updates, options.count)})


if __name__ == "__main__":
    main()
