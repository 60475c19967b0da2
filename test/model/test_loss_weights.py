"""LossWeights of beta and gamma. Paper, Alg. 1, line 13."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from embodied_active_learning.config import ObjectiveConfig
from embodied_active_learning.model.loss_weights import LossWeights, beta_from_log_std, gamma_from_coverage


def test_beta_matches_hand_computed_value():
    std = np.array([0.01, 0.1, 1.0])
    # h = std^k with k = 0.5 spans one decade: log10 beta = 1 - 4
    assert beta_from_log_std(np.log(std), 0.5, chi=4.0, beta_max=0.01) == pytest.approx(1e-3)


def test_beta_of_a_flat_model_is_ten_to_the_minus_chi():
    assert beta_from_log_std(np.full(5, -3.0), 1.0, chi=4.0, beta_max=0.01) == pytest.approx(1e-4)


def test_beta_is_clamped_even_if_the_power_overflows():
    assert beta_from_log_std(np.array([-1e6, 0.0]), 1.0, chi=4.0, beta_max=0.01) == 0.01


@given(st.lists(st.floats(-10.0, 2.0), min_size=1, max_size=30), st.floats(0.0, 1.0))
def test_beta_in_log_space_equals_the_papers_formula(log_std, coverage):
    h = np.exp(np.array(log_std)) ** coverage
    expected = min(10.0 ** (-math.log10(np.min(h / np.max(h))) - 4.0), 0.01)
    assert beta_from_log_std(np.array(log_std), coverage, 4.0, 0.01) == pytest.approx(expected, rel=1e-9)


def test_gamma_is_weight_times_coverage():
    assert gamma_from_coverage(0.6, 0.1) == pytest.approx(0.06)


def test_weights_start_with_smallest_beta_and_zero_gamma():
    weights = LossWeights(ObjectiveConfig())
    assert weights.beta == pytest.approx(1e-4)
    assert weights.gamma == 0.0


def test_weights_are_means_over_window():
    weights = LossWeights(ObjectiveConfig(schedule_window=2))
    for coverage in (0.2, 0.4, 0.8):
        weights.evaluate(np.array([0.0, math.log(10.0)]), coverage)
    assert weights.gamma == pytest.approx(0.1 * 0.6)
    assert weights.beta == pytest.approx((10.0**-3.6 + 10.0**-3.2) / 2)
    assert (weights.coverage, weights.log_std_min, weights.log_std_max) == (0.8, 0.0, math.log(10.0))


@pytest.mark.parametrize(("log_std", "coverage"), [([0.0, math.nan], 0.5), ([0.0, math.inf], 0.5), ([0.0], math.nan)])
def test_non_finite_evaluation_changes_nothing(log_std, coverage):
    weights = LossWeights(ObjectiveConfig())
    weights.evaluate(np.array([0.0, 1.0]), 0.5)
    before = weights.state_dict()
    weights.evaluate(np.array(log_std), coverage)
    assert weights.state_dict() == before


def test_restored_weights_continue_its_window():
    first, second = LossWeights(ObjectiveConfig(schedule_window=3)), LossWeights(ObjectiveConfig(schedule_window=3))
    for coverage in (0.1, 0.2, 0.3, 0.4):
        first.evaluate(np.array([-1.0, 0.5]), coverage)
    second.load_state_dict(first.state_dict())
    for weights in (first, second):
        weights.evaluate(np.array([-2.0, 0.5]), 0.9)
    assert (first.beta, first.gamma) == (second.beta, second.gamma)
    assert first.state_dict() == second.state_dict()
