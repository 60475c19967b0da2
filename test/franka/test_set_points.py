"""Set-points respect every limit and stay near the arm for any input and any delay."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CommandError
from embodied_active_learning.franka.mount import CameraPose
from embodied_active_learning.franka.set_points import MAX_PERIOD, SetPointStream

CONFIG = Config.from_dict({"arm": {"robot": "franka"}})
BOX = CONFIG.workspace.box()
LOWER, UPPER = np.array(BOX.lower), np.array(BOX.upper)
TOP = np.array([CONFIG.arm.max_speed, CONFIG.arm.max_speed, CONFIG.arm.max_turn_rate])
ACCELERATION = np.array([CONFIG.arm.max_acceleration, CONFIG.arm.max_acceleration, CONFIG.arm.max_turn_acceleration])
LEADS = np.array([CONFIG.franka.max_lead, CONFIG.franka.max_lead, CONFIG.franka.max_turn_lead])
PERIOD = 0.01
LEVEL = (0.0, 0.0)
ROUNDING = 1e-9

velocities = st.one_of(
    st.tuples(*(st.floats(-1.5 * top, 1.5 * top) for top in TOP)),
    st.tuples(*(st.floats(allow_nan=False, allow_infinity=False),) * 3),
)
places = st.tuples(*(st.floats(low, high) for low, high in zip(LOWER, UPPER)))
periods = st.one_of(st.floats(0.005, MAX_PERIOD), st.sampled_from([PERIOD, 0.1, 3.0]))


def at(planar, height=0.0, tilt=LEVEL):
    return CameraPose(tuple(map(float, planar)), height, tilt)


def begun(planar, **pose):
    stream = SetPointStream(CONFIG)
    stream.begin(at(planar, **pose))
    return stream


def planar(stream):
    return np.array(stream.set_point.planar)


class Follower:
    """An arm that follows the set-points with a lag, as under a spring, and not at all while it is held."""

    def __init__(self, place):
        self.place = np.array(place, dtype=float)

    def follow(self, stream, period, held):
        if not held:
            self.place += (1.0 - math.exp(-period / 0.34)) * (planar(stream) - self.place)
        return at(self.place)


legs = st.lists(
    st.tuples(velocities, st.sampled_from(["advance", "brake", "retreat"]), st.booleans(), st.integers(1, 40)),
    max_size=6,
)


@given(place=places, legs=legs, data=st.data())
def test_all_limits_hold_for_any_command_and_tick_delay(place, legs, data):
    stream, arm = begun(place), Follower(place)
    measured = at(place)
    inside = False
    for wanted, kind, held, ticks in legs:
        jitter = data.draw(st.lists(periods, min_size=1, max_size=5))
        for tick in range(ticks):
            period = jitter[tick % len(jitter)]
            before, speed = planar(stream), np.array(stream.velocity)
            if kind == "advance":
                stream.advance(wanted, measured, period)
            else:
                getattr(stream, kind)(measured, period)
            counted = min(period, MAX_PERIOD)
            assert np.isfinite(planar(stream)).all()
            assert np.all(np.abs(stream.velocity) <= TOP * (1.0 + ROUNDING))
            assert np.all(np.abs(stream.velocity - speed) <= counted * ACCELERATION * (1.0 + ROUNDING) + ROUNDING)
            step = np.abs(planar(stream) - before)
            assert np.all(step <= counted * np.maximum(TOP, np.abs(stream.velocity)) + ROUNDING)
            assert np.all(np.abs(planar(stream) - measured.planar) <= LEADS + ROUNDING)
            inside |= bool(BOX.contains(planar(stream)))
            assert not inside or BOX.contains(planar(stream), tolerance=ROUNDING)
            assert stream.set_point.height == 0.0
            assert stream.set_point.tilt == LEVEL
            measured = arm.follow(stream, counted, held)


def test_retreat_from_border_stays_in_workspace():
    """The second period is longer than the one that braking was planned with."""
    stream, measured = begun((0.5, UPPER[1], 0.0)), at((0.5, UPPER[1], 0.0))
    for period in (0.0078125, 0.02, 0.0078125, 0.02):
        stream.advance((0.0, -0.001, 0.0), measured, period)
    for period in (0.02, 0.005):
        stream.retreat(measured, period)
    for period in (0.005, 0.005, 0.02):
        stream.brake(measured, period)
        assert planar(stream)[1] <= UPPER[1]


@given(
    place=places,
    shoves=st.lists(st.tuples(*(st.floats(-0.3, 0.3),) * 3), min_size=1, max_size=20),
    wanted=velocities,
)
def test_pushed_arm_pulls_set_point_towards_itself_only(place, shoves, wanted):
    stream = begun(place)
    for shove in shoves:
        measured = at(np.add(place, shove))
        before = planar(stream)
        displaced = stream.advance(wanted, measured, PERIOD).displaced
        after = planar(stream)
        assert np.all(np.abs(after - measured.planar) <= LEADS + ROUNDING)
        leapt = np.abs(after - before) > PERIOD * TOP + ROUNDING
        assert displaced or not leapt.any()
        nearer = np.abs(after - measured.planar) <= np.abs(before - measured.planar) + ROUNDING
        assert np.all(nearer[leapt])


def test_set_point_waits_at_max_lead_of_blocked_arm():
    stream, place = begun(BOX.centre), BOX.centre
    for _ in range(300):
        step = stream.advance((0.1, 0.0, 0.5), at(place), PERIOD)
    assert step.limited
    np.testing.assert_allclose(planar(stream) - place, [LEADS[0], 0.0, LEADS[2]], atol=1e-6)
    np.testing.assert_allclose(stream.velocity, 0.0, atol=1e-6)


def test_late_tick_counts_as_max_period():
    late, soon = begun(BOX.centre), begun(BOX.centre)
    late.advance((0.1, 0.0, 0.0), at(BOX.centre), 5.0)
    soon.advance((0.1, 0.0, 0.0), at(BOX.centre), MAX_PERIOD)
    np.testing.assert_array_equal(planar(late), planar(soon))


def level(stream):
    return np.array([stream.set_point.height, *stream.set_point.tilt])


@pytest.mark.parametrize(("height", "tilt"), [(0.03, LEVEL), (0.0, (0.15, 0.0)), (0.0, (0.0, -0.15))])
def test_height_and_tilt_are_corrected_slowly(height, tilt):
    stream = begun(BOX.centre, height=height, tilt=tilt)
    track = [level(stream)] * 2  # at rest
    for _ in range(300):
        stream.advance((0.0, 0.0, 0.0), stream.set_point, PERIOD)
        track.append(level(stream))
    np.testing.assert_allclose(track[-1], 0.0, atol=1e-9)
    speeds = np.diff(track, axis=0) / PERIOD
    assert np.all(np.abs(speeds) <= np.array([0.02, 0.1, 0.1]) + ROUNDING)
    assert np.all(np.abs(np.diff(speeds, axis=0)) <= PERIOD * np.array([0.1, 0.5, 0.5]) + ROUNDING)


@given(shoves=st.lists(st.tuples(*(st.floats(-3.0, 3.0),) * 3), min_size=1, max_size=20))
def test_lead_of_height_and_tilt_is_limited(shoves):
    stream = begun(BOX.centre)
    limits = np.array([CONFIG.franka.max_lead, CONFIG.franka.max_turn_lead, CONFIG.franka.max_turn_lead])
    for shove in shoves:
        height, *tilt = shove * limits
        stream.advance((0.0, 0.0, 0.0), at(BOX.centre, height, tuple(tilt)), PERIOD)
        assert np.all(np.abs(level(stream) - (height, *tilt)) <= limits + ROUNDING)


def test_only_commanded_motion_leads_back_into_workspace():
    outside = np.array([UPPER[0] + 0.03, 0.0, 0.0])
    stream = begun(outside)
    for _ in range(100):
        stream.brake(at(outside), PERIOD)
    np.testing.assert_array_equal(planar(stream), outside)
    for _ in range(300):
        stream.advance((0.1, 0.0, 0.0), at(planar(stream)), PERIOD)
    assert BOX.contains(planar(stream))


def test_retreat_ends_at_measured_pose():
    stream, place = begun(BOX.centre), BOX.centre
    for _ in range(40):
        stream.advance((0.1, 0.0, 0.0), at(place), PERIOD)
    assert planar(stream)[0] - place[0] > 0.02
    for _ in range(100):
        stream.retreat(at(place), PERIOD)
    np.testing.assert_allclose(planar(stream), place, atol=1e-6)
    assert stream.lead(at(place)) == pytest.approx((0.0, 0.0), abs=1e-6)


def test_yaw_measured_beyond_pi_is_unwrapped():
    stream = begun((0.5, 0.0, 3.1))
    stream.brake(at((0.5, 0.0, 3.15 - 2.0 * math.pi)), PERIOD)
    assert planar(stream)[2] == pytest.approx(3.1)


def test_advance_before_begin_is_rejected():
    with pytest.raises(CommandError, match="no set-point"):
        SetPointStream(CONFIG).advance((0.0, 0.0, 0.0), at(BOX.centre), PERIOD)
