"""Time averages against ensemble averages, and the two-sample test."""

import numpy as np
import pytest

import embodied_active_learning as eal
from embodied_active_learning.evaluation.ergodicity import (
    average_error,
    draw_independent,
    fixed_log_std,
    follow_target,
    two_sample_test,
    view_features,
)
from embodied_active_learning.simulation.scene import Scene
from embodied_active_learning.simulation.simulation import Simulation
from embodied_active_learning.simulation.world import load_world
from tiny import TINY


def normal(count, mean, seed):
    return np.random.default_rng(seed).normal(mean, 1.0, (count, 3))


def test_average_error_is_in_standard_deviations():
    reference = normal(4000, 0.0, 0) * [1.0, 10.0, 100.0]
    shifted = reference + np.array([0.5, 5.0, 50.0])
    assert average_error(shifted, reference) == pytest.approx(0.5, rel=0.05)
    assert average_error(reference, reference) == 0.0


def test_two_sample_test_distinguishes_shifted_samples():
    assert two_sample_test(normal(200, 0.5, 1), normal(200, 0.0, 2), 0).p_value < 0.01


def test_two_sample_test_has_the_stated_error_rate():
    """Of 40 pairs of equal distributions, about 5 % are below 0.05; 6 or more happen in 1.4 % of all cases."""
    rejected = [two_sample_test(normal(40, 0.0, i), normal(40, 0.0, 100 + i), 0).p_value < 0.05 for i in range(40)]
    assert sum(rejected) < 6


def test_views_follow_a_target(tmp_path):
    """A target on one side of the table draws both the explorer and independent views there."""
    session = eal.learn(eal.load_config("", root=str(tmp_path), name="run", world="diagonal", **TINY))
    model, config = eal.load_model(session), session.config
    workspace = config.workspace.box()

    def log_std(states):
        return 4.0 * workspace.normalise(states)[:, 0]

    world = load_world(config.simulation.world, workspace)
    with Simulation(world, config) as simulation:
        views = follow_target(config, simulation, log_std, 30)
    scene = Scene(world, config.camera)
    independent = draw_independent(config, scene, log_std, 50, 0)
    scene.close()
    assert views.images.shape == (30, 24, 24, 3)
    assert workspace.normalise(views.states)[-10:, 0].mean() > 0.3
    assert workspace.normalise(independent.states)[:, 0].mean() > 0.5
    assert view_features(model, independent).shape == (50, 3 + 2 + 1)
    latents, _ = model.encode(views.states[:4], views.images[:4])
    assert fixed_log_std(model, latents)(views.states).shape == (30,)
