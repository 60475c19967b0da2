"""Decisions as a text table."""

import pytest

from embodied_active_learning.objects.decision import FOUND, NOT_HERE, UNDECIDED
from embodied_active_learning.objects.decision_table import decision_table
from embodied_active_learning.objects.fingerprint import BLANK, OBJECT
from sample_decisions import make_decision


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
    decision = make_decision(kind=kind, outcome=outcome, pose=(0.4, -0.1, 0.6), confidence=0.976)
    header, _, row = decision_table([decision]).splitlines()
    names = ["outcome", "x [m]", "y [m]", "yaw [rad]", "confidence"]
    places = [header.index(name) for name in names]
    assert [row[place:].split("  ")[0].strip() for place in places] == cells
