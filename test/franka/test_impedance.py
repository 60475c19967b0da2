"""Lag under the impedance controller's law, against values computed by hand and the stand-in."""

import math

import pytest

from embodied_active_learning.config import Config, load_profile
from embodied_active_learning.franka.impedance import lag, lead_warnings, required_leads, turn_lag
from fake_franka.impedance import ImpedanceHand, inverse, multiply, rotation_vector, turned_by
from launching import ROOT

LAB = Config.from_dict(load_profile(ROOT / "config" / "franka.yaml"))


def test_lag_of_translation():
    assert lag(0.1, 200.0) == pytest.approx(0.1 * (0.2 + 0.141421), abs=1e-6)


@pytest.mark.parametrize(("rate", "stiffness", "angle"), [(0.3, 20.0, 0.329), (0.45, 30.0, 0.420)])
def test_lag_of_rotation(rate, stiffness, angle):
    """0.2 rate + 2 asin(2 rate / sqrt(stiffness)); about (0.2 + 4 / sqrt(stiffness)) rate for small rates."""
    assert turn_lag(rate, stiffness) == pytest.approx(angle, abs=1e-3)
    assert turn_lag(1e-3, stiffness) == pytest.approx(1e-3 * (0.2 + 4.0 / math.sqrt(stiffness)), rel=1e-5)


@pytest.mark.parametrize("stiffness", [10.0, 20.0, 30.0])
def test_stand_in_trails_by_turn_lag(stiffness):
    hand = ImpedanceHand((0.5, 0.0, 0.3), (1.0, 0.0, 0.0, 0.0))
    hand.set_stiffness(200.0, stiffness)
    rate = 0.25
    for step in range(12000):
        hand.set_point = (hand.set_point[0], multiply(turned_by((0.0, 0.0, 0.001 * rate * step)), (1.0, 0.0, 0.0, 0.0)))
        hand.advance()
    behind = rotation_vector(multiply(hand.set_point[1], inverse(hand.orientation)))
    assert behind[2] == pytest.approx(turn_lag(rate, stiffness), abs=2e-3)
    assert hand.turning[2] == pytest.approx(rate, abs=1e-3)


def test_lab_profile_reaches_its_top_speeds():
    assert lead_warnings(LAB) == []
    assert required_leads(LAB) == pytest.approx((0.0444, 0.480), abs=1e-3)


def test_unreachable_speeds_are_reported():
    fast = Config.from_dict({**LAB.to_dict(), "arm": {**LAB.to_dict()["arm"], "max_turn_rate": 0.6, "max_speed": 0.2}})
    assert [line.split()[0] for line in lead_warnings(fast)] == ["arm/max_speed", "arm/max_turn_rate"]


def test_spring_overcomes_joint_friction_at_turn_tolerance():
    """A Panda's joints stick up to about 1 Nm; the spring has to leave more than that at the tolerance."""
    assert LAB.franka.turn_stiffness * math.sin(LAB.franka.turn_tolerance / 2.0) > 1.2
