#!/usr/bin/env python3
"""Time of one planning step, by length of history.

On one core: OMP_NUM_THREADS=1 python benchmarks/benchmark_planner.py

A step is what the planner does between two commands, without the model: refresh the samples, form the target, plan,
and count the state reached. Histories alternate within one process, so that other load on the machine meets all alike.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from typing import Callable, Dict, List

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.exploration.coverage import workspace_coverage
from embodied_active_learning.exploration.ergodic import ErgodicController
from embodied_active_learning.exploration.samples import WorkspaceSamples
from embodied_active_learning.exploration.target import target_distribution

HISTORIES = (0, 200, 1000, 3000)  # states visited before
PARTS = ("refresh", "target", "plan", "visit")


class Loop:
    """The exploration loop with perfect dynamics, after a history of random states."""

    def __init__(self, config: Config, history: int) -> None:
        """Visit `history` random states and the middle of the workspace."""
        states = np.random.default_rng(1).uniform(-1.0, 1.0, (history, 3))
        self.samples = WorkspaceSamples(config, [*states, np.zeros(3)])
        self.controller = ErgodicController(config, seed=0)
        self.times: Dict[str, List[float]] = {part: [] for part in PARTS}

    def step(self) -> None:
        """One planning step, each part timed."""
        self._timed("refresh", self.samples.refresh)
        # stands for the entropy of a model; only its unevenness matters for the time
        log_std = -3.0 + 2.0 * np.abs(self.samples.states[:, 0])
        target = self._timed("target", lambda: target_distribution(log_std, self.samples.coverage))
        self._timed("plan", lambda: self.controller.next_command(target, self.samples))
        position = self.controller.planned_states[0]
        self._timed("visit", lambda: self.samples.visit(position))
        self.controller.observe(position)

    def _timed(self, part: str, call: Callable[[], object]) -> object:
        begin = time.perf_counter()
        result = call()
        self.times[part].append(1e3 * (time.perf_counter() - begin))
        return result


def report(loops: Dict[int, Loop]) -> None:
    """Print medians, and the 90th percentile of the whole step."""
    print("history | " + " | ".join(PARTS) + " | step median | step p90  [ms]")
    for history, loop in loops.items():
        step = np.sum([loop.times[part] for part in PARTS], axis=0)
        medians = " | ".join(f"{np.median(loop.times[part]):.2f}" for part in PARTS)
        print(f"{history} | {medians} | {np.median(step):.2f} | {np.percentile(step, 90):.2f}")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=100, help="steps timed at each history")
    parser.add_argument("--samples", type=int, default=1000, help="workspace samples S")
    parser.add_argument("--fresh", type=int, default=100, help="samples drawn anew at each step")
    arguments = parser.parse_args()
    config = Config()
    exploration = dataclasses.replace(
        config.exploration, samples=arguments.samples, fresh_samples=arguments.fresh, kernel_variance=0.0576
    )
    config = dataclasses.replace(config, exploration=exploration)
    loops = {history: Loop(config, history) for history in HISTORIES}
    for _ in range(arguments.steps):
        for loop in loops.values():
            loop.step()
    report(loops)
    samples = loops[HISTORIES[-1]].samples
    begin = time.perf_counter()
    workspace_coverage(samples.states, samples.visited, 0.0576)
    print(f"coverage k of {len(samples.visited)} states from scratch: {1e3 * (time.perf_counter() - begin):.2f} ms")


if __name__ == "__main__":
    main()
