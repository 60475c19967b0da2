"""Conditional-entropy target and KL-ergodic measure."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from embodied_active_learning.errors import EmbodiedActiveLearningError
from embodied_active_learning.exploration.ergodic_objective import (
    FLOOR,
    kl_ergodic,
    target_distribution,
    uniform_distribution,
)

WEIGHTS = arrays(np.float64, (30,), elements=st.floats(0, 1e6, allow_subnormal=False))


def test_target_by_hand():
    np.testing.assert_allclose(target_distribution(np.log([0.1, 0.4]), 0.5), [1 / 3, 2 / 3])


def test_target_flat_without_coverage_or_contrast():
    np.testing.assert_allclose(target_distribution(np.array([-4.0, 0.0, 1.0]), 0.0), uniform_distribution(3))
    np.testing.assert_allclose(target_distribution(np.zeros(3), 0.7), uniform_distribution(3))


@given(arrays(np.float64, (30,), elements=st.floats(-10, 2)), st.floats(0, 1))
def test_target_sums_to_one_and_respects_floor(log_std, coverage):
    target = target_distribution(log_std, coverage)
    assert np.sum(target) == pytest.approx(1.0)
    assert np.all(target > 0.99 * FLOOR)


def test_target_finite_for_extreme_log_stds():
    assert np.all(np.isfinite(target_distribution(np.array([-1e4, 0.0, 1e4]), 1.0)))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_non_finite_entropy_rejected(bad):
    with pytest.raises(EmbodiedActiveLearningError, match="not finite at 1 of 3 samples"):
        target_distribution(np.array([0.0, bad, 0.0]), 0.5)


def test_ergodic_measure_by_hand():
    assert kl_ergodic(np.array([0.5, 0.5]), np.array([3.0, 1.0])) == pytest.approx(
        0.5 * np.log(0.5 / 0.75) + 0.5 * np.log(0.5 / 0.25)
    )


@given(WEIGHTS, WEIGHTS)
def test_ergodic_measure_bounds(target, visitation):
    assert -1e-12 <= kl_ergodic(target, visitation) <= -np.log(0.5 * FLOOR)


@given(WEIGHTS)
def test_ergodic_measure_zero_if_visitation_matches_target(target):
    assert kl_ergodic(target, 7.0 * target) == pytest.approx(0.0, abs=1e-9)


def test_time_average_flat_without_visited_states():
    assert kl_ergodic(uniform_distribution(10), np.zeros(10)) == pytest.approx(0.0, abs=1e-12)
