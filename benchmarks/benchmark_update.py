#!/usr/bin/env python3
"""Time and memory of model updates: the plain network, torch alone, and what the trainer runs, by turns in one process.

    source setup.bash && python3 benchmarks/benchmark_update.py

Other work on the cores disturbs all alike: trust the ratios before the milliseconds.
"""

from __future__ import annotations

import argparse
import ctypes
from typing import Callable, Dict, List

import numpy as np
import torch
from measuring import Row, Section, resident_memory, rows_of, run, single_precision_peak, take_turns

from embodied_active_learning.config import Config
from embodied_active_learning.model.allocator import M_MMAP_THRESHOLD, M_TRIM_THRESHOLD, keep_freed_memory
from embodied_active_learning.model.block_images import BlockImages
from embodied_active_learning.model.cvae import ConditionalVAE
from embodied_active_learning.model.fast import FastLoss
from embodied_active_learning.model.learner import Learner
from embodied_active_learning.model.objective import plain_loss

PLAIN = "plain network, eager, memory as PyTorch has it"
KEPT = "plain network, eager, freed memory kept"
TORCH = "torch alone: blocks, one decode, no copies"
CHOSEN = "as the trainer runs it"
MANY = 3000  # observations of the paper's run


class RandomStore:
    """Observations of noise, in the paper's size: speed does not depend on what is in the images."""

    def __init__(self, count: int) -> None:
        random = np.random.default_rng(0)
        self.states = random.uniform(-1.0, 1.0, (count, 3)).astype(np.float32)
        self.images = random.integers(0, 256, (count, 180, 180, 3), dtype=np.uint8)

    def __len__(self) -> int:
        return len(self.states)


def floating_point_operations(network: ConditionalVAE, batch: int) -> float:
    """Of one update of `batch` images: one encode and two decodes, forwards and backwards, without Adam."""
    layers = [layer for layer in network.image_encoder if isinstance(layer, torch.nn.Conv2d)]
    convolutions = [
        2.0 * layer.weight.numel() * height * width for layer, (height, width) in zip(layers, network.sizes[1:])
    ]
    encoder, decoder = (
        sum(2.0 * layer.weight.numel() for layer in part if isinstance(layer, torch.nn.Linear))
        for part in (network.encoder, network.decoder)
    )
    # The image itself needs no gradient.
    encode = 3.0 * (sum(convolutions) + encoder) - convolutions[0]
    return batch * (encode + 2.0 * 3.0 * (sum(convolutions) + decoder))


def handle_memory(keep: bool) -> None:
    """Keep freed memory, or handle it as glibc does by default once it has met blocks of this size."""
    if keep:
        keep_freed_memory()
        return
    mallopt = ctypes.CDLL(None).mallopt
    mallopt(M_MMAP_THRESHOLD, 2**25)
    mallopt(M_TRIM_THRESHOLD, 2**26)


def update_section(arguments: argparse.Namespace) -> Section:
    """A whole update, from the gathering of the batch to the step of Adam."""
    store, config = RandomStore(256), Config.from_dict({"training": {"device": "cpu"}})
    threads = arguments.threads or torch.get_num_threads()
    torch.set_num_threads(threads)
    chosen = Learner(config, store, 0)
    plain, kept = (Learner(config, store, 0, plain_loss) for _ in range(2))
    blocks = Learner(config, store, 0, FastLoss(BlockImages(plain.network)))
    variants: Dict[str, Callable[[], object]] = {
        PLAIN: plain.update,
        KEPT: kept.update,
        TORCH: blocks.update,
        CHOSEN: chosen.update,
    }

    def prepare(name: str) -> None:
        """Threads and memory of the variant, and an update that is not counted to get used to them."""
        torch.set_num_threads(threads if name in (PLAIN, KEPT) else chosen.arithmetic.torch_threads)
        handle_memory(keep=name != PLAIN)
        variants[name]()

    turns = take_turns(variants, arguments.rounds, prepare)
    handle_memory(keep=True)
    rows = rows_of(turns, {TORCH: "2 times faster", CHOSEN: "4 times faster"})
    peak = single_precision_peak(threads)
    work = floating_point_operations(plain.network, config.training.batch_size)
    for row in rows:
        row.peak_share = work / (1e6 * row.wall) / peak if peak else None
    speed = f"{peak:.0f} GFLOP/s measured" if peak else "not measured, there is no compiler"
    how = (
        f"64 images of 180 x 180, one encode, two decodes, Adam: {work / 1e9:.2f} GFLOP. {threads} threads, torch"
        f" {torch.__version__}, {chosen.arithmetic.description}. Peak: {speed}. Ratios are to the plain network."
    )
    return Section("One model update", how, rows)


def memory_section(arguments: argparse.Namespace) -> Section:
    """What the process holds when the store is full, and whether it still grows."""
    config = Config.from_dict({"training": {"device": "cpu"}})
    learner = Learner(config, RandomStore(MANY), 0)
    learner.updates = 3 * MANY - 1  # all observations are in its batches
    torch.set_num_threads(learner.arithmetic.torch_threads)
    held = []
    for _ in range(3):
        for _ in range(arguments.rounds):
            learner.update()
            learner.refresh()
        learner.evaluate()
        held.append(resident_memory())
    row = Row(
        "resident memory", value=f"{held[-1]:.0f} MiB, {held[-1] - held[0]:+.1f} MiB since", target="2000 MiB, flat"
    )
    how = (
        f"A learner with {MANY} observations in memory; after {3 * arguments.rounds} updates with an evaluation each"
        f" {arguments.rounds}, and the difference to {arguments.rounds} updates. The process held the benchmark before."
    )
    return Section("The trainer's memory", how, [row])


def measure(arguments: argparse.Namespace) -> List[Section]:
    """Both sections."""
    keep_freed_memory()
    return [update_section(arguments), memory_section(arguments)]


if __name__ == "__main__":
    run(__doc__, measure, threads=0, rounds=12)
