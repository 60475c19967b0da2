"""The spectral metric, and the methods that cover a density."""

import numpy as np
import pytest

from embodied_active_learning.config import Config
from embodied_active_learning.evaluation import coverage
from embodied_active_learning.evaluation.spectral import (
    DENSITIES,
    SpectralMetric,
    grid_points,
    kl_measure,
    three_gaussians,
    uniform,
)

METRIC = SpectralMetric.of(three_gaussians)


def test_metric_of_the_target_itself_is_zero():
    assert SpectralMetric.of(uniform).value(grid_points()) == pytest.approx(0.0, abs=1e-12)


def test_metric_of_one_point_is_that_computed_by_hand():
    """Two coefficients each: f_00 = 1, f_10 = sqrt(2) cos(pi x), f_11 = 2 cos(pi x) cos(pi y); target 1, 0, 0, 0."""
    metric = SpectralMetric.of(uniform, 2)
    f = np.sqrt(2.0) * np.cos(np.pi * 0.25)
    expected = 2.0 * f**2 * 2.0**-1.5 + (f * f) ** 2 * 3.0**-1.5
    assert metric.value(np.array([[0.25, 0.25]])) == pytest.approx(expected)


def test_gradient_of_metric_is_that_of_finite_differences():
    positions = np.random.default_rng(0).uniform(size=(5, 2))
    factors = 2.0 * METRIC.weights * (METRIC.coefficients(positions) - METRIC.target) / len(positions)
    gradient = METRIC.gradient(positions, factors)
    for index in np.ndindex(5, 2):
        step = np.zeros((5, 2))
        step[index] = 1e-6
        change = (METRIC.value(positions + step) - METRIC.value(positions - step)) / 2e-6
        assert gradient[index] == pytest.approx(change, rel=1e-4, abs=1e-7)


def test_measures_prefer_samples_of_the_density():
    good = coverage.independent_samples(three_gaussians, 500, 0)
    bad = coverage.independent_samples(uniform, 500, 0)
    assert METRIC.value(good) < 0.1 * METRIC.value(bad)
    assert kl_measure(good, three_gaussians) < 0.2 < kl_measure(bad, three_gaussians)


@pytest.mark.parametrize(
    ("method", "limit"), [("SMC", 0.2), ("trajectory optimisation", 0.01), ("planner", 0.2), ("random walk", 2.0)]
)
def test_method_covers_within_the_limits_of_the_arm(method, limit):
    positions = coverage.METHODS[method](three_gaussians, 60, 3)
    assert positions.shape == (60, 2)
    assert np.all((positions >= 0.0) & (positions <= 1.0))
    dynamics = coverage.planar_dynamics(Config())
    largest = 0.5 * dynamics.step * dynamics.gain * dynamics.velocity_limit
    if method != "random walk":  # which heads for random states at the border
        assert np.all(np.abs(np.diff(positions, axis=0)) <= largest + 1e-9)
    assert METRIC.value(positions) < limit


def test_method_is_repeatable():
    for name in DENSITIES:
        first, again = (coverage.smc_trajectory(DENSITIES[name], 20, 1) for _ in range(2))
        np.testing.assert_array_equal(first, again)
