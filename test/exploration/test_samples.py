"""Workspace samples: time average, coverage k, refreshing, resuming."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.exploration.kernel import CoverageKernel, workspace_coverage
from embodied_active_learning.exploration.samples import History, WorkspaceSamples


def configuration(normalise=True, **exploration):
    config = Config()
    values = {"samples": 200, "fresh_samples": 20, **exploration}
    return dataclasses.replace(
        config,
        exploration=dataclasses.replace(config.exploration, **values),
        planner=dataclasses.replace(config.planner, normalise_kernels=normalise),
    )


def states(count, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (count, 3))


def test_coverage_by_hand():
    samples = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]])
    visited = np.array([[0.0, 0.0, 0.0], [0.0, 0.9, 0.0]])
    assert workspace_coverage(samples, visited, 0.05) == pytest.approx((1 + np.exp(-0.25 / 0.1)) / 2, rel=1e-5)


def test_time_average_by_hand():
    """Kernels of states at distance 0 and 0.5, variance 0.05: 1 + exp(-2.5)."""
    kernel = CoverageKernel(0.05)
    history = History(kernel, 3, [np.zeros(3), np.array([0.5, 0.0, 0.0])])
    total, largest = history.kernels(kernel.sample_features(np.zeros((1, 3))))
    assert (total[0], largest[0]) == (pytest.approx(1.082085, rel=1e-5), pytest.approx(1.0))


def test_coverage_zero_without_visited_states():
    assert workspace_coverage(states(10), np.empty((0, 3)), 0.05) == 0.0
    assert WorkspaceSamples(configuration()).coverage == 0.0


def test_authors_coverage_counts_samples_outside_as_covered():
    samples, visited = np.array([[0.0, 0.0, 0.0], [0.6, 0.0, 0.0], [1.1, 0.0, 0.0]]), np.array([[0.1, 0.0, 0.0]])
    near, far = np.exp(-0.01 / 0.1), np.exp(-0.25 / 0.1)
    assert workspace_coverage(samples, visited, 0.05, authors=True) == pytest.approx((1 + far / near + 1) / 3, rel=1e-5)


def test_authors_coverage_zero_without_visited_states():
    assert workspace_coverage(states(10), np.empty((0, 3)), 0.05, authors=True) == 0.0


@settings(max_examples=15)
@given(st.integers(0, 600), st.integers(0, 30), st.booleans(), st.sampled_from([0, 7, 20, 200]))
def test_recursive_sums_equal_direct_sums(before, steps, normalise, fresh):
    config = configuration(normalise, fresh_samples=fresh)
    samples = WorkspaceSamples(config, states(before))
    for state in states(steps, seed=1):
        samples.refresh()
        samples.visit(state)
    kernel = CoverageKernel.from_config(config)
    direct = kernel(samples.states, samples.visited).sum(axis=0, dtype=np.float64)
    np.testing.assert_allclose(samples.visitation, direct, rtol=1e-4, atol=1e-12)
    assert samples.coverage == pytest.approx(
        workspace_coverage(samples.states, samples.visited, kernel.variance), abs=1e-5
    )


def test_refresh_replaces_all_samples_in_turn():
    samples = WorkspaceSamples(configuration(fresh_samples=30))
    first = samples.states
    for _ in range(6):
        samples.refresh()
    assert np.any(np.all(samples.states == first, axis=1))
    samples.refresh()
    assert not np.any(samples.states == first)


@pytest.mark.parametrize("box", [1.0, 1.15])
def test_samples_fill_the_box_and_no_more(box):
    drawn = WorkspaceSamples(configuration(samples=5000, sample_box=box)).states
    assert np.all(np.abs(drawn) <= box)
    assert np.all(np.abs(drawn).max(axis=0) > 0.99 * box)


def test_samples_resumed_from_visited_states():
    config = configuration(fresh_samples=0)
    run = WorkspaceSamples(config)
    for state in states(1500):
        run.visit(state)
    resumed = WorkspaceSamples(config, run.visited)
    np.testing.assert_array_equal(resumed.visited, states(1500))
    np.testing.assert_allclose(resumed.visitation, run.visitation, rtol=1e-5)


def test_samples_depend_on_seed():
    drawn = [WorkspaceSamples(configuration(seed=3)).states for _ in range(2)]
    np.testing.assert_array_equal(*drawn)
    assert not np.any(WorkspaceSamples(configuration(seed=4)).states == drawn[0])


@pytest.mark.parametrize("state", [[np.nan, 0, 0], [0, np.inf, 0], [0, 0], [[0, 0, 0]]])
def test_malformed_visit_rejected_without_change(state):
    samples = WorkspaceSamples(configuration(), states(5))
    before = samples.visitation
    with pytest.raises(ObservationError, match="3 finite numbers"):
        samples.visit(np.array(state))
    np.testing.assert_array_equal(samples.visitation, before)
    assert len(samples.visited) == 5


def test_configured_variance_replaces_authors_rule():
    assert WorkspaceSamples(configuration(kernel_variance=0.1)).kernel.variance == 0.1
    assert WorkspaceSamples(configuration(samples=1000)).kernel.variance == pytest.approx(0.057588, abs=1e-6)
