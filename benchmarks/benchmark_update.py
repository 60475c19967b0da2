#!/usr/bin/env python3
"""Times one model update (plain against fast) and the planner's question for the log std, taking turns in one process.

Other work on the cores disturbs both sides alike: trust the ratios before the milliseconds.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import sys
import time
from pathlib import Path
from typing import Callable, Dict, List, NamedTuple

import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "src"))

from embodied_active_learning.config import Config
from embodied_active_learning.model.learner import Learner
from embodied_active_learning.model.memory import keep_freed_memory
from embodied_active_learning.model.objective import plain_loss

WARM_UP = 3


class Turn(NamedTuple):
    """What one call took: wall time and time on all cores [ms], and pages fetched from the system."""

    wall: float
    cpu: float
    faults: int


class RandomStore:
    """Observations of noise, in the paper's size: speed does not depend on what is in the images."""

    def __init__(self, count: int) -> None:
        random = np.random.default_rng(0)
        self.states = random.uniform(-1.0, 1.0, (count, 3)).astype(np.float32)
        self.images = random.integers(0, 256, (count, 180, 180, 3), dtype=np.uint8)

    def __len__(self) -> int:
        return len(self.states)


def take_turns(variants: Dict[str, Callable[[], object]], repeats: int) -> Dict[str, List[Turn]]:
    """Call the variants one after the other, again and again. The first rounds are not counted."""
    turns: Dict[str, List[Turn]] = {name: [] for name in variants}
    for _ in range(WARM_UP + repeats):
        for name, call in variants.items():
            faults, cpu, wall = _faults(), time.process_time(), time.perf_counter()
            call()
            elapsed = time.perf_counter() - wall
            turns[name].append(Turn(1e3 * elapsed, 1e3 * (time.process_time() - cpu), _faults() - faults))
    return {name: taken[WARM_UP:] for name, taken in turns.items()}


def show(title: str, turns: Dict[str, List[Turn]]) -> None:
    """Print medians, and the median of each round's ratio to the first variant."""
    print(f"\n{title}")
    print(f"{'variant':<44}{'wall ms':>9}{'min':>9}{'cpu ms':>9}{'faults':>9}{'ratio':>8}")
    reference = next(iter(turns.values()))
    for name, taken in turns.items():
        ratio = statistics.median(one.wall / other.wall for one, other in zip(reference, taken))
        wall, cpu, faults = (statistics.median(column) for column in zip(*taken))
        fastest = min(turn.wall for turn in taken)
        print(f"{name:<44}{wall:>9.2f}{fastest:>9.2f}{cpu:>9.2f}{faults:>9.0f}{ratio:>7.2f}x")


def update_variants(store: RandomStore, device: str) -> Dict[str, Callable[[], object]]:
    """A whole update, from the gathering of the batch to the step of Adam, with either loss."""
    config = Config.from_dict({"training": {"device": device}})
    plain, fast = Learner(config, store, 0, plain_loss), Learner(config, store, 0)
    return {"update, plain": plain.update, "update, as the trainer runs it": fast.update}


def planning_variants(store: RandomStore, samples: int) -> Dict[str, Callable[[], object]]:
    """The log std at S states from one latent: the first of all outputs, or that output alone."""
    learner = Learner(Config.from_dict({"training": {"device": "cpu"}}), store, 0)
    states, latent = np.random.default_rng(1).uniform(-1.0, 1.0, (samples, 3)), np.zeros(16)
    inputs = torch.zeros(samples, 16), torch.from_numpy(states.astype(np.float32))

    def whole_decoder() -> torch.Tensor:
        with torch.inference_mode():
            return learner.network.decode_features(*inputs)[0]

    return {
        "log std, all 3921 outputs": whole_decoder,
        "log std, that output alone": lambda: learner.snapshot.log_std(states, latent),
    }


def _faults() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--threads", type=int, default=0, help="CPU threads; 0 takes every core")
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--samples", type=int, default=1000, help="workspace samples of a planning step")
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    parser.add_argument("--return-memory", action="store_true", help="leave the C library's allocator as it is")
    arguments = parser.parse_args()
    if arguments.threads:
        torch.set_num_threads(arguments.threads)
    kept = not arguments.return_memory and keep_freed_memory()
    print(
        f"torch {torch.__version__}, {torch.get_num_threads()} threads, freed memory {'kept' if kept else 'returned'}"
    )
    if not kept:
        print("many faults? LD_PRELOAD=libtcmalloc_minimal.so.4 does the same as keep_freed_memory()")
    store = RandomStore(256)
    updates = update_variants(store, arguments.device)
    show("One update: 64 images of 180 x 180, one encode, two decodes, Adam", take_turns(updates, arguments.repeats))
    planning = planning_variants(store, arguments.samples)
    show(f"Planning: log std at {arguments.samples} states", take_turns(planning, 4 * arguments.repeats))


if __name__ == "__main__":
    main()
