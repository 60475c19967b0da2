"""Decisions as a text table."""

import pytest

from embodied_active_learning.objects.decision import FOUND, NOT_HERE, UNDECIDED
from embodied_active_learning.objects.decision_table import decision_table
from embodied_active_learning.objects.fingerprint import BLANK, OBJECT
from embodied_active_learning.objects.scoring import TrueObject, Truth
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


@pytest.mark.parametrize(("x", "place"), [(0.40, "duck_2"), (0.44, "beside duck_2"), (0.50, "bare table")])
def test_false_claim_names_the_object_of_the_world_file(x, place):
    objects = [TrueObject("duck_1", "duck", 0.3, 0.1), TrueObject("duck_2", "duck", 0.4, -0.1)]
    decision = make_decision(pose=(x, -0.1, 0.0))
    truth = Truth(objects, {(decision.session, decision.fingerprint): "star"})
    assert f"false positive: {place}  " in decision_table([decision], truth)
