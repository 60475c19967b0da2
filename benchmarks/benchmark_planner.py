#!/usr/bin/env python3
"""Time of one planning step, the question to the model included, by length of history; on one core.

    source setup.bash && OPENBLAS_NUM_THREADS=1 python3 benchmarks/benchmark_planner.py

A step is what the planner does between two commands: refresh the samples, ask the model for the log standard deviation
at all of them given the newest image, form the target, plan, and count the state reached. Histories, and the plain ways
to do two of its parts, take turns within one process.
"""

from __future__ import annotations

import argparse
from typing import Callable, Dict, List

import numpy as np
import torch
from measuring import Row, Section, Turn, rows_of, run, take_turns, timed

from embodied_active_learning.config import Config
from embodied_active_learning.exploration.controller import ErgodicController
from embodied_active_learning.exploration.kernel import workspace_coverage
from embodied_active_learning.exploration.objective import target_distribution
from embodied_active_learning.exploration.samples import WorkspaceSamples
from embodied_active_learning.model.learner import Learner

HISTORIES = (0, 200, 1000, 3000)  # states visited before
PARTS = ("refresh", "question", "target", "plan", "visit")


class Store:
    """One observation of noise."""

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
        self._snapshots = learner.snapshots
        self.turns: Dict[str, List[Turn]] = {part: [] for part in PARTS}

    def step(self) -> None:
        """One planning step, each part timed."""
        self._timed("refresh", self.samples.refresh)
        position = self.samples.visited[-1]
        self._timed(
            "question",
            lambda: self._snapshots.conditional_log_std(self.samples.states, position, Store.images[0]),
        )
        # Stands for what a trained model says; only its unevenness matters for the time.
        log_std = -3.0 + 2.0 * np.abs(self.samples.states[:, 0])
        target = self._timed("target", lambda: target_distribution(log_std, self.samples.coverage))
        self._timed("plan", lambda: self.controller.next_command(target, self.samples))
        reached = self.controller.planned_states[0]
        self._timed("visit", lambda: self.samples.visit(reached))
        self.controller.observe(reached)

    def whole(self) -> List[Turn]:
        """The steps, all parts together."""
        return [Turn(*map(sum, zip(*parts))) for parts in zip(*self.turns.values())]

    def _timed(self, part: str, call: Callable[[], object]) -> object:
        answers: List[object] = []
        self.turns[part].append(timed(lambda: answers.append(call())))
        return answers[0]


def step_section(config: Config, learner: Learner, arguments: argparse.Namespace) -> Section:
    """Whole steps by history, then the parts of the longest."""
    loops = {history: Loop(config, history, learner) for history in HISTORIES}
    for _ in range(arguments.rounds):
        for loop in loops.values():
            loop.step()
    rows: List[Row] = []
    for history, loop in loops.items():
        [row] = rows_of({f"step with {history} visited states": loop.whole()})
        row.ratio, row.target = None, "10 ms" if history == HISTORIES[-1] else ""
        rows.append(row)
    for part in PARTS:
        [row] = rows_of({f"of that: {part}": loops[HISTORIES[-1]].turns[part]})
        row.ratio = None
        rows.append(row)
    exploration = config.exploration
    how = f"{exploration.samples} samples, {exploration.fresh_samples} of them fresh at each step; one thread."
    return Section("One planning step", how, rows)


def question_section(config: Config, learner: Learner, arguments: argparse.Namespace) -> Section:
    """The log std at the samples from one latent: the first of all outputs, or that output alone."""
    states = np.random.default_rng(1).uniform(-1.0, 1.0, (config.exploration.samples, 3))
    inputs = torch.zeros(len(states), 16), torch.from_numpy(states.astype(np.float32))

    def whole_decoder() -> torch.Tensor:
        with torch.inference_mode():
            return learner.network.decode_features(*inputs)[0]

    variants = {
        "all 3921 outputs": whole_decoder,
        "that output alone": lambda: learner.snapshots.log_std(states, np.zeros(16)),
    }
    how = f"The log standard deviation at {len(states)} states from one latent; one thread."
    return Section("The question to the model", how, rows_of(take_turns(variants, arguments.rounds)))


def coverage_section(config: Config, arguments: argparse.Namespace) -> Section:
    """Workspace coverage when one state more was visited: from scratch, or kept up."""
    loop = WorkspaceSamples(config, np.random.default_rng(1).uniform(-1.0, 1.0, (HISTORIES[-1], 3)))
    variance = config.exploration.kernel_variance

    def kept_up() -> float:
        loop.visit(np.zeros(3))
        return loop.coverage

    variants = {
        "from scratch": lambda: workspace_coverage(loop.states, loop.visited, variance),
        "kept up": kept_up,
    }
    how = f"Coverage k of {HISTORIES[-1]} visited states over {config.exploration.samples} samples; one thread."
    return Section("Visitation", how, rows_of(take_turns(variants, arguments.rounds)))


def measure(arguments: argparse.Namespace) -> List[Section]:
    """All three sections."""
    torch.set_num_threads(1)
    values = {"samples": arguments.samples, "fresh_samples": arguments.fresh, "kernel_variance": 0.0576}
    config = Config.from_dict({"exploration": values, "training": {"device": "cpu"}})
    learner = Learner(config, Store(), 0)
    return [
        step_section(config, learner, arguments),
        question_section(config, learner, arguments),
        coverage_section(config, arguments),
    ]


if __name__ == "__main__":
    run(__doc__, measure, samples=1000, fresh=100, rounds=100)
