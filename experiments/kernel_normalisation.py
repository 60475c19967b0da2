#!/usr/bin/env python3
"""Compare ergodic control with and without normalised coverage kernels (planner/normalise_kernels).

    source setup.bash && OPENBLAS_NUM_THREADS=1 python3 experiments/kernel_normalisation.py [--seeds 12] [--steps 500]

Both variants run in closed loop with perfect dynamics and the same seeds, for a uniform target, for one with two peaks
as a trained model predicts them, and for one with a peak in a corner. Since each variant minimises its own
D_KL(h || d), the visited states are evaluated by three measures: with plain kernels (Paper, Eq. 8), with normalised
kernels, and by a histogram, which needs no kernel. Printed are median (largest) over the seeds; a standstill is a
sequence of steps that change every normalised coordinate by less than 0.001.
"""

from __future__ import annotations

import argparse
import dataclasses
from typing import Callable, Dict, List

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.exploration.controller import ErgodicController
from embodied_active_learning.exploration.ergodic_objective import FLOOR, kl_ergodic, target_distribution
from embodied_active_learning.exploration.kernel import CoverageKernel, kernel_variance
from embodied_active_learning.exploration.samples import WorkspaceSamples

CHECKPOINTS = (120, 200, 400)  # steps
STILL = 1e-3  # normalised
BORDER = 0.9  # normalised; a uniform distribution spends 1 - 0.9^3 = 0.271 beyond it
CELLS = (6, 6, 4)  # of the histogram, in x, y and theta
EVALUATION = np.random.default_rng(2**31).uniform(-1.0, 1.0, (20000, 3))
VARIANCE = kernel_variance(1000, 3)
MEASURES = ("plain kernel", "normalised kernel", "histogram")
Spread = Callable[[np.ndarray], np.ndarray]


def flat(states: np.ndarray) -> np.ndarray:
    """Return a constant log standard deviation."""
    return np.zeros(len(states))


def peaks(*centres: List[float]) -> Spread:
    """Return a log standard deviation with peaks of radius 0.2 at centres in x and y, like those of learned objects."""

    def log_std(states: np.ndarray) -> np.ndarray:
        square = np.sum((states[:, np.newaxis, :2] - np.array(centres)) ** 2, axis=-1)
        return np.log(0.02 + 0.15 * np.sum(np.exp(-0.5 * square / 0.04), axis=1))

    return log_std


TARGETS: Dict[str, Spread] = {
    "uniform": flat,
    "two peaks": peaks([-0.63, -0.67], [0.3, 0.53]),
    "corner": peaks([-0.95, -0.95]),
}


def explore(normalise: bool, log_std: Spread, seed: int, steps: int) -> np.ndarray:
    """Return the states (steps + 1, 3) visited from rest in the middle of the workspace."""
    config = Config()
    config = dataclasses.replace(
        config,
        exploration=dataclasses.replace(config.exploration, seed=seed),
        planner=dataclasses.replace(config.planner, normalise_kernels=normalise),
    )
    controller, samples = ErgodicController(config, seed), WorkspaceSamples(config, [np.zeros(3)])
    for _ in range(steps):
        controller.observe(samples.visited[-1])
        samples.refresh()
        controller.next_command(target_distribution(log_std(samples.states), samples.coverage), samples)
        samples.visit(controller.planned_states[0])
    return samples.visited


def divergences(visited: np.ndarray, log_std: Spread) -> List[float]:
    """Return D_KL(h || d) [nat] of visited states by each of MEASURES; h is std^k with k = 1 for a common target."""
    target = target_distribution(log_std(EVALUATION), 1.0)
    values = []
    for normalise in (False, True):
        kernel = CoverageKernel(VARIANCE, normalise=normalise)
        visitation = sum(kernel(EVALUATION, part).sum(axis=0) for part in np.array_split(visited, 20))
        values.append(kl_ergodic(target, visitation))
    edges = [np.linspace(-1.0, 1.0, count + 1) for count in CELLS]
    wanted, _ = np.histogramdd(EVALUATION, edges, weights=target)
    spent, _ = np.histogramdd(np.clip(visited, -1.0, 1.0), edges)
    spent = (spent + 0.5) / np.sum(spent + 0.5)
    wanted = np.maximum(wanted, FLOOR) / np.sum(np.maximum(wanted, FLOOR))
    return [*values, float(np.sum(wanted * np.log(wanted / spent)))]


def longest_standstill(visited: np.ndarray) -> int:
    """Return the largest number of consecutive steps without motion."""
    longest = current = 0
    for still in np.max(np.abs(np.diff(visited, axis=0)), axis=1) < STILL:
        current = current + 1 if still else 0
        longest = max(longest, current)
    return longest


def main() -> None:
    """Run all variants and print one table for each target."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=12)
    parser.add_argument("--steps", type=int, default=500)
    options = parser.parse_args()
    for name, log_std in TARGETS.items():
        print(f"\n{name} target, {options.seeds} seeds, {options.steps} steps")
        for normalise in (False, True):
            runs = [explore(normalise, log_std, seed, options.steps) for seed in range(options.seeds)]
            print("normalised kernels" if normalise else "plain kernels")
            stills = [longest_standstill(run) for run in runs]
            border = [np.mean(np.max(np.abs(run), axis=1) > BORDER) for run in runs]
            print(f"  longest standstill  {np.median(stills):.0f} ({max(stills)}) steps")
            print(f"  share of time beyond {BORDER}  {np.median(border):.3f} ({max(border):.3f})")
            for step in (step for step in CHECKPOINTS if step <= options.steps):
                values = np.array([divergences(run[: step + 1], log_std) for run in runs])
                columns = zip(MEASURES, np.median(values, axis=0), values.max(axis=0))
                print(f"  D_KL at {step:4d}  " + ", ".join(f"{m} {a:.3f} ({b:.3f})" for m, a, b in columns))


if __name__ == "__main__":
    main()
