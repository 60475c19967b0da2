#!/usr/bin/env python3
"""Time and memory of model updates: the plain network and the compiled kernels, alternating in one process.

    source setup.bash && python3 benchmarks/benchmark_update.py

Other load on the cores affects both alike: the ratios are more reliable than the milliseconds.
"""

from __future__ import annotations

import argparse
from typing import Callable, Dict, List

import numpy as np
import torch
from measuring import Row, Section, resident_memory, rows_of, run, single_precision_peak, take_turns

from embodied_active_learning.config import Config
from embodied_active_learning.model.cvae import ConditionalVAE
from embodied_active_learning.model.learner import Learner
from embodied_active_learning.model.loss import PlainLoss

PLAIN = "plain network, autograd"
CHOSEN = "as in the trainer"
OBSERVATIONS = 3000  # of the paper's run


class RandomStore:
    """Random observations of the paper's size: the time does not depend on the content."""

    def __init__(self, count: int) -> None:
        random = np.random.default_rng(0)
        self.states = random.uniform(-1.0, 1.0, (count, 3)).astype(np.float32)
        self.images = random.integers(0, 256, (count, 180, 180, 3), dtype=np.uint8)

    def __len__(self) -> int:
        return len(self.states)


def floating_point_operations(network: ConditionalVAE, batch: int) -> float:
    """Return the operations of one update: one encode and two decodes, forward and backward, without Adam."""
    layers = [layer for layer in network.image_encoder if isinstance(layer, torch.nn.Conv2d)]
    convolutions = [
        2.0 * layer.weight.numel() * height * width for layer, (height, width) in zip(layers, network.sizes[1:])
    ]
    encoder, decoder = (
        sum(2.0 * layer.weight.numel() for layer in part if isinstance(layer, torch.nn.Linear))
        for part in (network.encoder, network.decoder)
    )
    # No gradient by the image.
    encode = 3.0 * (sum(convolutions) + encoder) - convolutions[0]
    return batch * (encode + 2.0 * 3.0 * (sum(convolutions) + decoder))


def update_section(arguments: argparse.Namespace) -> Section:
    """Measure whole updates, from reading the batch to the step of Adam."""
    store, config = RandomStore(256), Config.from_dict({"training": {"device": "cpu"}})
    threads = arguments.threads or torch.get_num_threads()
    torch.set_num_threads(threads)
    learners = {PLAIN: Learner(config, store, 0, PlainLoss("plain network")), CHOSEN: Learner(config, store, 0)}
    variants: Dict[str, Callable[[], object]] = {name: learner.update for name, learner in learners.items()}

    def prepare(name: str) -> None:
        """Set the variant's threads, and make one update that is not counted."""
        torch.set_num_threads(learners[name].loss.torch_threads)
        variants[name]()

    rows = rows_of(take_turns(variants, arguments.rounds, prepare), {CHOSEN: "4 times faster"})
    peak = single_precision_peak(threads)
    work = floating_point_operations(learners[PLAIN].network, config.training.batch_size)
    for row in rows:
        if row.wall is not None and peak is not None:
            row.peak_share = work / (1e6 * row.wall) / peak
    speed = f"{peak:.0f} GFLOP/s measured" if peak else "not measured, no compiler"
    how = (
        f"64 images of 180 x 180, one encode, two decodes, Adam: {work / 1e9:.2f} GFLOP. {threads} threads, torch"
        f" {torch.__version__}, {learners[CHOSEN].loss.description}. Peak: {speed}. Ratios: to the plain network."
    )
    return Section("One model update", how, rows)


def memory_section(arguments: argparse.Namespace) -> Section:
    """Measure the memory of a process with a full store, and whether it grows."""
    config = Config.from_dict({"training": {"device": "cpu"}})
    learner = Learner(config, RandomStore(OBSERVATIONS), 0)
    learner.updates = 3 * OBSERVATIONS - 1  # batches are drawn from all observations
    torch.set_num_threads(learner.loss.torch_threads)
    resident = []
    for _ in range(3):
        for _ in range(arguments.rounds):
            learner.update()
            learner.refresh()
        learner.evaluate()
        resident.append(resident_memory())
    value = f"{resident[-1]:.0f} MiB, {resident[-1] - resident[0]:+.1f} MiB since the first measurement"
    how = (
        f"A learner with {OBSERVATIONS} observations in memory, after {3 * arguments.rounds} updates with three"
        f" evaluations; first measurement after {arguments.rounds} updates. Includes what the section above has left."
    )
    return Section("The trainer's memory", how, [Row("resident memory", value=value, target="2000 MiB, constant")])


def measure(arguments: argparse.Namespace) -> List[Section]:
    """Return both sections."""
    return [update_section(arguments), memory_section(arguments)]


if __name__ == "__main__":
    run(__doc__, measure, threads=0, rounds=12)
