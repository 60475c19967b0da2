"""The workspace: SI units to normalised states and back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from embodied_active_learning.errors import ConfigError
from embodied_active_learning.workspace import Workspace

STATES = arrays(np.float64, (4, 3), elements=st.floats(-5, 5))


@given(STATES)
def test_normalise_and_denormalise_are_inverse(states):
    workspace = Workspace()
    np.testing.assert_allclose(workspace.denormalise(workspace.normalise(states)), states, atol=1e-12)


def test_limits_normalise_to_plus_and_minus_one():
    workspace = Workspace()
    np.testing.assert_allclose(workspace.normalise([workspace.lower, workspace.upper]), [[-1] * 3, [1] * 3], atol=1e-12)


def test_one_normalised_unit_is_15_cm_and_2_rad():
    np.testing.assert_allclose(Workspace().scale, [0.15, 0.15, 2.0])


@given(STATES)
def test_clipped_states_are_inside(states):
    workspace = Workspace()
    assert np.all(workspace.contains(workspace.clip(states), tolerance=1e-12))


@pytest.mark.parametrize(
    ("yaw", "expected"), [(1.0, 1.0), (-3.0, 3.0), (6.0, 0.0), (-0.2, 0.0), (7.0, 7.0 - 2.0 * np.pi)]
)
def test_nearest_state_may_differ_by_a_full_turn(yaw, expected):
    workspace = Workspace((0.3, -0.1, 0.0), (0.6, 0.1, 3.0))
    np.testing.assert_allclose(workspace.nearest([[0.7, 0.0, yaw]]), [[0.6, 0.0, expected]])


def test_nan_is_outside():
    assert not Workspace().contains([np.nan, 0.0, 0.0])


def test_reversed_limits_are_rejected():
    with pytest.raises(ConfigError, match="workspace/y is"):
        Workspace(lower=(0.3, 0.2, -2.0), upper=(0.6, -0.2, 2.0))
