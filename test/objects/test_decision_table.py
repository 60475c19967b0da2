"""Decisions as a text table."""

import numpy as np
import pytest

from embodied_active_learning.objects.decision import FOUND, NOT_HERE, UNDECIDED, Decision
from embodied_active_learning.objects.decision_table import decision_table
from embodied_active_learning.objects.fingerprint import BLANK, OBJECT


@pytest.mark.parametrize(
    ("kind", "outcome", "cells"),
    [
        (OBJECT, FOUND, ["found, place 1", "0.400", "-0.100", "0.60", "0.98"]),
        (BLANK, FOUND, ["found, place 1", "0.400", "-0.100", "-", "0.98"]),
        (OBJECT, UNDECIDED, ["undecided", "-", "-", "-", "0.98"]),
        (OBJECT, NOT_HERE, ["not here", "-", "-", "-", "-"]),
    ],
)
def test_decision_table_shows_pose_and_confidence(kind, outcome, cells):
    pose = np.array([0.4, -0.1, 0.6])
    decision = Decision("a", "object-1", kind, outcome, 1, pose, 0.976, 0.05, 0.1, 5, 0.5, 0.1, "similarity 0.80")
    header, _, row = decision_table([decision]).splitlines()
    names = ["outcome", "x [m]", "y [m]", "yaw [rad]", "confidence"]
    places = [header.index(name) for name in names]
    assert [row[place:].split("  ")[0].strip() for place in places] == cells
