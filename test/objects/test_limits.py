"""Limits of the similarity, and their calibration."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from embodied_active_learning.errors import ObservationError
from embodied_active_learning.objects.limits import Calibration

NINETEEN = np.linspace(0.0, 0.9, 19)


@pytest.mark.parametrize(
    ("error_rate", "miss", "look_alike"), [(0.05, 0.0, 0.75), (0.25, 0.2, 0.45), (0.01, -1.0, 1.0)]
)
def test_limits_are_conformal_quantiles(error_rate, miss, look_alike):
    """With 19 similarities, a rate of 0.05 takes the smallest one, and a smaller rate cannot be guaranteed."""
    limits = Calibration(NINETEEN, NINETEEN).limits(error_rate)
    assert limits == pytest.approx((miss, look_alike))
    assert limits.found == max(limits)


def test_confidence_is_share_of_less_similar_look_alikes():
    assert Calibration(NINETEEN, NINETEEN).confidence(0.425) == 9 / 20


@given(st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=60), st.floats(0.001, 0.5))
def test_miss_limit_rejects_at_most_error_rate_of_true_places(values, error_rate):
    true = np.sort(np.array(values))
    miss = Calibration(true, true).limits(error_rate).miss
    assert (true < miss).sum() <= error_rate * (len(true) + 1)


@pytest.mark.parametrize(
    "values",
    [np.zeros(0), np.zeros((2, 2)), np.zeros(3, np.float32), np.array([0.5, 0.2]), np.array([2.0]), np.array([np.nan])],
)
def test_invalid_calibration_is_refused(values):
    with pytest.raises(ObservationError, match="ascending float64"):
        Calibration(NINETEEN, values)


@pytest.mark.parametrize("trials", [1, 19, 48, 99, 4999])
def test_smallest_error_rate_still_has_a_miss_limit(trials):
    values = np.linspace(0.0, 0.9, trials)
    calibration = Calibration(values, values)
    assert calibration.limits(calibration.smallest_error_rate).miss == values[0]


def test_rank_is_exact_despite_rounding():
    """Of 99 similarities, a rate of 0.29 takes the 29th and 0.1 leaves 40 look-alikes of 100 above."""
    values = np.linspace(0.0, 0.98, 99)
    limits = Calibration(values, values).limits(0.29)
    assert limits.miss == values[28]
    assert Calibration(values, values).limits(0.1).look_alike == values[59]
