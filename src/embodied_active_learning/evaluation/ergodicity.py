"""How time averages along a run approach ensemble averages under a fixed target. Paper, Sec. 3, Birkhoff's theorem.

The model is trained beforehand and does not change, so that the target is the same for all steps and explorers.
"""

from __future__ import annotations

from typing import Callable, List, NamedTuple

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.exploration.ergodic_objective import target_distribution
from embodied_active_learning.exploration.samples import WorkspaceSamples
from embodied_active_learning.model.trained_model import TrainedModel
from embodied_active_learning.registry import EXPLORERS
from embodied_active_learning.simulation.scene import Scene
from embodied_active_learning.simulation.simulation import Simulation
from embodied_active_learning.subsampling import spread_indices

_PROPOSALS = 20000
_TESTED = 300
"""Observations of each side in a two-sample test."""
_PERMUTATIONS = 200
LogStd = Callable[[np.ndarray], np.ndarray]


class Views(NamedTuple):
    """Observations: states (N, 3) [m, m, rad] and images (N, H, W, 3) uint8."""

    states: np.ndarray
    images: np.ndarray


class TwoSampleTest(NamedTuple):
    """Squared maximum mean discrepancy, unbiased, and the share of permutations that reach it."""

    mmd2: float
    p_value: float


def fixed_log_std(model: TrainedModel, latents: np.ndarray) -> LogStd:
    """Return the log of the standard deviation that a model predicts, averaged over latents (N, L)."""
    return lambda states: np.log(np.exp(model.log_std(latents, states)).mean(axis=0))


def follow_target(config: Config, simulation: Simulation, log_std: LogStd, steps: int) -> Views:
    """Return what the configured explorer observes in a simulation while the target does not change.

    Args:
        config: Configuration with explorer and seed.
        simulation: The world, with the arm at its start.
        log_std: Log standard deviation (S,) at states (S, 3); the target is its exponential.
        steps: Number of observations.
    """
    workspace = config.workspace.box()
    explorer = EXPLORERS[config.exploration.explorer](config, config.exploration.seed)
    samples = WorkspaceSamples(config)
    states, images = [], []
    for _ in range(steps):
        states.append(simulation.pose)
        images.append(simulation.image())
        samples.visit(workspace.normalise(simulation.pose))
        samples.refresh()
        explorer.observe(workspace.normalise(simulation.pose), simulation.velocity)
        target = target_distribution(log_std(workspace.denormalise(samples.states)), 1.0)
        simulation.execute(explorer.next_command(target, samples))
    return Views(np.array(states), np.array(images))


def draw_independent(config: Config, scene: Scene, log_std: LogStd, count: int, seed: int) -> Views:
    """Return views drawn independently from the target: states by resampling, images rendered at them."""
    random, workspace = np.random.default_rng(seed), config.workspace.box()
    proposals = random.uniform(workspace.lower, workspace.upper, (_PROPOSALS, workspace.size))
    states = proposals[random.choice(_PROPOSALS, count, p=target_distribution(log_std(proposals), 1.0))]
    return Views(states, np.array([scene.render(state, config.camera.distance) for state in states]))


def view_features(model: TrainedModel, views: Views) -> np.ndarray:
    """Return features (N, F) of views: mean colour, latent means, and the squared error of the decoded image."""
    means, _ = model.encode(views.states, views.images)
    pixels = views.images.astype(np.float32) / 255.0
    decoded = np.concatenate([model.decode(means[part], views.states[part])[0] for part in _parts(len(means))])
    errors = np.mean((decoded - pixels) ** 2, axis=(1, 2, 3))
    return np.column_stack([pixels.mean(axis=(1, 2)), means, errors])


def average_error(features: np.ndarray, reference: np.ndarray) -> float:
    """Return the root mean square, over features, of the difference between two averages in standard deviations.

    Args:
        features: (N, F) along a run.
        reference: (M, F) drawn independently; its standard deviations are the unit.
    """
    std = np.maximum(reference.std(axis=0), 1e-9)
    return float(np.sqrt(np.mean(((features.mean(axis=0) - reference.mean(axis=0)) / std) ** 2)))


def two_sample_test(features: np.ndarray, reference: np.ndarray, seed: int) -> TwoSampleTest:
    """Test whether features (N, F) and reference (M, F) have the same distribution, with a Gaussian kernel.

    Features are divided by the reference's standard deviations; the kernel's width is the median distance. At most 300
    of each side are used, evenly spread. The permutations assume independent samples: neighbours on a path are not, so
    that a small p-value of a path means "distinguishable from independent samples".
    """
    std = np.maximum(reference.std(axis=0), 1e-9)
    first, second = (part[spread_indices(len(part), _TESTED)] / std for part in (features, reference))
    pooled = np.concatenate([first, second])
    squares = np.sum((pooled[:, np.newaxis] - pooled) ** 2, axis=-1)
    width = np.median(squares[len(first) :, len(first) :][np.triu_indices(len(second), 1)])
    kernel = np.exp(-squares / max(float(width), 1e-12))
    random = np.random.default_rng(seed)
    value = _mmd2(kernel, np.arange(len(pooled)), len(first))
    permuted = [_mmd2(kernel, random.permutation(len(pooled)), len(first)) for _ in range(_PERMUTATIONS)]
    return TwoSampleTest(value, (1 + sum(other >= value for other in permuted)) / (1 + _PERMUTATIONS))


def _mmd2(kernel: np.ndarray, order: np.ndarray, split: int) -> float:
    first, second = order[:split], order[split:]
    within = [(np.sum(kernel[np.ix_(p, p)]) - len(p)) / (len(p) * (len(p) - 1)) for p in (first, second)]
    return float(sum(within) - 2.0 * np.mean(kernel[np.ix_(first, second)]))


def _parts(count: int) -> List[slice]:
    return [slice(begin, begin + 64) for begin in range(0, count, 64)]
