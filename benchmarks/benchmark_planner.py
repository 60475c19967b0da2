#!/usr/bin/env python3
"""Time of a planning step, including the query of the model, by length of the history; on one core.

    source setup.bash && OPENBLAS_NUM_THREADS=1 python3 benchmarks/benchmark_planner.py

A step is the work between two commands: refresh the samples, query the model's log standard deviation at all of them
given the newest image, compute the target, plan, and add the reached state. Histories, and simpler variants of two
parts, are interleaved in one process.
"""

from __future__ import annotations

import argparse
from typing import Callable, Dict, List

import numpy as np
import torch
from measuring import Row, Section, Turn, rows_of, run, take_turns, timed

from embodied_active_learning.config import Config
from embodied_active_learning.exploration.controller import ErgodicController
from embodied_active_learning.exploration.ergodic_objective import target_distribution
from embodied_active_learning.exploration.kernel import workspace_coverage
from embodied_active_learning.exploration.samples import WorkspaceSamples
from embodied_active_learning.model.learner import Learner

HISTORIES = (0, 200, 1000, 3000)  # visited states
PARTS = ("refresh", "query", "target", "plan", "visit")


class Store:
    """A store with one observation, noise."""

    states = np.zeros((1, 3), np.float32)
    images = np.random.default_rng(0).integers(0, 256, (1, 180, 180, 3), dtype=np.uint8)

    def __len__(self) -> int:
        return 1


class Loop:
    """The exploration loop with perfect dynamics, after a history of random states."""

    def __init__(self, config: Config, history: int, learner: Learner) -> None:
        """Visit `history` random states and the middle of the workspace."""
        states = np.random.default_rng(1).uniform(-1.0, 1.0, (history, 3))
        self.samples = WorkspaceSamples(config, [*states, np.zeros(3)])
        self.controller = ErgodicController(config, seed=0)
        self._replicas = learner.replicas
        self.turns: Dict[str, List[Turn]] = {part: [] for part in PARTS}

    def step(self) -> None:
        """Make a planning step, and time each part."""
        self._timed("refresh", self.samples.refresh)
        position = self.samples.visited[-1]
        self._timed(
            "query",
            lambda: self._replicas.conditional_log_std(self.samples.states, position, Store.images[0]),
        )
        # In place of a trained model: an uneven target takes the planner as long.
        log_std = -3.0 + 2.0 * np.abs(self.samples.states[:, 0])
        target = self._timed("target", lambda: target_distribution(log_std, self.samples.coverage))
        self._timed("plan", lambda: self.controller.next_command(target, self.samples))
        reached = self.controller.planned_states[0]
        self._timed("visit", lambda: self.samples.visit(reached))
        self.controller.observe(reached)

    def total(self) -> List[Turn]:
        """Return the times of whole steps."""
        return [Turn(*map(sum, zip(*parts))) for parts in zip(*self.turns.values())]

    def _timed(self, part: str, call: Callable[[], object]) -> object:
        results: List[object] = []
        self.turns[part].append(timed(lambda: results.append(call())))
        return results[0]


def step_section(config: Config, learner: Learner, arguments: argparse.Namespace) -> Section:
    """Return the time of steps by history, then of the parts with the longest."""
    loops = {history: Loop(config, history, learner) for history in HISTORIES}
    for _ in range(arguments.rounds):
        for loop in loops.values():
            loop.step()
    rows: List[Row] = []
    for history, loop in loops.items():
        [row] = rows_of({f"step with {history} visited states": loop.total()})
        row.ratio, row.target = None, "10 ms" if history == HISTORIES[-1] else ""
        rows.append(row)
    for part in PARTS:
        [row] = rows_of({f"part: {part}": loops[HISTORIES[-1]].turns[part]})
        row.ratio = None
        rows.append(row)
    exploration = config.exploration
    how = f"{exploration.samples} samples, of which {exploration.fresh_samples} are replaced in each step; one thread."
    return Section("One planning step", how, rows)


def query_section(config: Config, learner: Learner, arguments: argparse.Namespace) -> Section:
    """Compare the query for one latent: all outputs of the decoder, or only the log standard deviation."""
    states = np.random.default_rng(1).uniform(-1.0, 1.0, (config.exploration.samples, 3))
    inputs = torch.zeros(len(states), 16), torch.from_numpy(states.astype(np.float32))

    def full_decoder() -> torch.Tensor:
        with torch.inference_mode():
            return learner.network.decode_features(*inputs)[0]

    variants = {
        "all 3921 outputs": full_decoder,
        "log standard deviation only": lambda: learner.replicas.log_std(states, np.zeros(16)),
    }
    how = f"The log standard deviation at {len(states)} states from one latent; one thread."
    return Section("Query of the model", how, rows_of(take_turns(variants, arguments.rounds)))


def coverage_section(config: Config, arguments: argparse.Namespace) -> Section:
    """Compare the workspace coverage after another visit: from scratch, or recursively."""
    loop = WorkspaceSamples(config, np.random.default_rng(1).uniform(-1.0, 1.0, (HISTORIES[-1], 3)))
    variance = config.exploration.kernel_variance

    def recursive() -> float:
        loop.visit(np.zeros(3))
        return loop.coverage

    variants = {
        "from scratch": lambda: workspace_coverage(loop.states, loop.visited, variance),
        "recursive": recursive,
    }
    how = f"Coverage k of {HISTORIES[-1]} visited states over {config.exploration.samples} samples; one thread."
    return Section("Visitation", how, rows_of(take_turns(variants, arguments.rounds)))


def measure(arguments: argparse.Namespace) -> List[Section]:
    """Return all three sections."""
    torch.set_num_threads(1)
    values = {"samples": arguments.samples, "fresh_samples": arguments.fresh, "kernel_variance": 0.0576}
    config = Config.from_dict({"exploration": values, "training": {"device": "cpu"}})
    learner = Learner(config, Store(), 0)
    return [
        step_section(config, learner, arguments),
        query_section(config, learner, arguments),
        coverage_section(config, arguments),
    ]


if __name__ == "__main__":
    run(__doc__, measure, samples=1000, fresh=100, rounds=100)
