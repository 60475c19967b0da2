"""The entropy target and the KL-ergodic measure."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from embodied_active_learning.errors import EmbodiedActiveLearningError
from embodied_active_learning.exploration.target import FLOOR, flat_distribution, kl_ergodic, target_distribution

WEIGHTS = arrays(np.float64, (30,), elements=st.floats(0, 1e6, allow_subnormal=False))


def test_the_target_is_the_standard_deviation_to_the_power_of_the_coverage():
    np.testing.assert_allclose(target_distribution(np.log([0.1, 0.4]), 0.5), [1 / 3, 2 / 3])


def test_the_target_is_flat_when_nothing_has_been_covered_or_learned():
    np.testing.assert_allclose(target_distribution(np.array([-4.0, 0.0, 1.0]), 0.0), flat_distribution(3))
    np.testing.assert_allclose(target_distribution(np.zeros(3), 0.7), flat_distribution(3))


@given(arrays(np.float64, (30,), elements=st.floats(-10, 2)), st.floats(0, 1))
def test_a_target_sums_to_one_and_no_sample_gets_less_than_the_floor(log_std, coverage):
    target = target_distribution(log_std, coverage)
    assert np.sum(target) == pytest.approx(1.0)
    assert np.all(target > 0.99 * FLOOR)


def test_extreme_log_stds_neither_overflow_nor_underflow():
    assert np.all(np.isfinite(target_distribution(np.array([-1e4, 0.0, 1e4]), 1.0)))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_entropy_that_is_not_finite_is_refused(bad):
    with pytest.raises(EmbodiedActiveLearningError, match="1 of 3 samples is not finite"):
        target_distribution(np.array([0.0, bad, 0.0]), 0.5)


def test_the_measure_by_hand():
    assert kl_ergodic(np.array([0.5, 0.5]), np.array([3.0, 1.0])) == pytest.approx(
        0.5 * np.log(0.5 / 0.75) + 0.5 * np.log(0.5 / 0.25)
    )


@given(WEIGHTS, WEIGHTS)
def test_the_measure_is_never_negative_and_bounded_by_the_floor(target, visitation):
    assert -1e-12 <= kl_ergodic(target, visitation) <= -np.log(0.5 * FLOOR)


@given(WEIGHTS)
def test_the_measure_is_zero_when_time_was_spent_as_the_target_asks(target):
    assert kl_ergodic(target, 7.0 * target) == pytest.approx(0.0, abs=1e-9)


def test_before_any_state_was_visited_the_time_average_counts_as_flat():
    assert kl_ergodic(flat_distribution(10), np.zeros(10)) == pytest.approx(0.0, abs=1e-12)
