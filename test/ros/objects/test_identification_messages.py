"""Belief grids and fingerprints as messages."""

from __future__ import annotations

import numpy as np
import rospy

from embodied_active_learning.config import IdentificationConfig
from embodied_active_learning.objects.beliefs import BeliefGrid
from embodied_active_learning.ros.objects.identification_output import grid_message
from embodied_active_learning.ros.objects.messages import fingerprint_message
from embodied_active_learning.workspace import Workspace
from sample_fingerprints import make_set


def make_grid(value):
    grid = BeliefGrid(Workspace(), IdentificationConfig(cells=(20, 20, 12)))
    grid.update(np.array([[0.45, 0.0, 0.0]]), np.array([value]), np.ones(1))
    return grid


def test_grids_share_one_scale():
    """A weak belief stays dark next to a strong one."""
    weak, strong = make_grid(0.55), make_grid(1.0)
    scale = float(strong.above_median().max())
    low, high = (max(grid_message(rospy.Time(1), grid, scale).data) for grid in (weak, strong))
    assert high == 100
    assert 5 <= low <= 20
    assert min(grid_message(rospy.Time(1), strong, scale).data) == 0


def test_fingerprint_message_has_no_pixels():
    found = make_set()
    message = fingerprint_message(rospy.Time(1), found, found.fingerprints[0])
    assert (message.session, message.name, message.views, message.updates) == ("a", "object-1", 3, 9000)
    assert len(str(message)) < 500
