"""No velocity that is requested takes an arm over its limits of speed, acceleration and workspace."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CommandError
from embodied_active_learning.motion_limits import MotionLimits

CONFIG = Config()
BOX = CONFIG.workspace.box()
LOWER, UPPER = np.array(BOX.lower), np.array(BOX.upper)
TOP = np.array([CONFIG.arm.max_speed, CONFIG.arm.max_speed, CONFIG.arm.max_turn_rate])
ACCELERATION = np.array([CONFIG.arm.max_acceleration, CONFIG.arm.max_acceleration, CONFIG.arm.max_turn_acceleration])
PERIOD = 1 / 240
REST = [0.0, 0.0, 0.0]
ROUNDING = 1e-9  # of a limit

finite = st.floats(allow_nan=False, allow_infinity=False)
sensible = st.floats(-2.0, 2.0)
requested_velocities = st.lists(st.one_of(sensible, finite), min_size=3, max_size=3)
absurd = st.sampled_from([math.nan, math.inf, -math.inf, None, "1", 10**400])


@st.composite
def limits_and_poses(draw):
    """Limits of any plausible arm, and a pose inside its workspace."""
    lower = np.array(draw(st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=3)))
    upper = lower + draw(st.lists(st.floats(0.01, 4.0), min_size=3, max_size=3))
    tops = draw(st.lists(st.floats(0.001, 2.6), min_size=3, max_size=3))
    accelerations = draw(st.lists(st.floats(0.1, 25.0), min_size=3, max_size=3))
    part = np.array(draw(st.lists(st.floats(0.0, 1.0), min_size=3, max_size=3)))
    pose = np.clip(lower + part * (upper - lower), lower, upper)
    return MotionLimits(lower, upper, tops, accelerations), np.array(tops), np.array(accelerations), pose


@pytest.fixture
def limits():
    return MotionLimits.from_config(CONFIG)


def follow(limits, pose, velocity, requested, period, ticks):
    """Yields poses and velocities (3,) of an arm that does exactly as it may."""
    for _ in range(ticks):
        velocity = limits.next_velocity(pose, velocity, requested, period).velocity
        pose = [at + period * speed for at, speed in zip(pose, velocity)]
        yield pose, velocity


@given(
    case=limits_and_poses(),
    legs=st.lists(st.tuples(requested_velocities, st.integers(1, 60)), max_size=6),
    data=st.data(),
)
def test_no_request_exceeds_a_limit(case, legs, data):
    limits, tops, accelerations, pose = case
    period = data.draw(st.floats(1e-3, 0.1))
    velocity = REST

    def hold(requested, ticks):
        nonlocal pose, velocity
        for next_pose, next_velocity in follow(limits, pose, velocity, requested, period, ticks):
            change = np.abs(np.subtract(next_velocity, velocity))
            assert np.all(change <= (1.0 + ROUNDING) * period * accelerations)
            assert np.all(np.abs(next_velocity) <= tops)
            assert np.all(next_pose >= np.array(limits.lower) - ROUNDING)
            assert np.all(next_pose <= np.array(limits.upper) + ROUNDING)
            pose, velocity = next_pose, next_velocity

    for requested, ticks in legs:
        hold(requested, ticks)
    hold(REST, math.ceil(limits.braking_time(velocity) / period) + 1)
    np.testing.assert_allclose(velocity, REST, atol=1e-6)


@given(
    pose=st.lists(finite, min_size=3, max_size=3),
    previous=st.lists(finite, min_size=3, max_size=3),
    requested=requested_velocities,
    period=st.floats(1e-6, 1.0),
)
def test_velocity_does_not_jump_from_absurd_state(pose, previous, requested, period):
    limits = MotionLimits.from_config(CONFIG)
    velocity = np.array(limits.next_velocity(pose, previous, requested, period).velocity)
    reachable = period * ACCELERATION + ROUNDING + 1e-15 * np.abs(previous)
    assert np.all(np.abs(velocity - previous) <= np.nextafter(reachable, np.inf))
    assert np.all(np.abs(velocity) <= np.maximum(TOP, np.abs(previous)))


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("outwards", [0.0, 1.0])
@pytest.mark.parametrize("distance", [1e-6, 1e-3, 0.05, 3.0])
def test_arm_returns_from_outside_the_workspace(limits, side, outwards, distance):
    border = UPPER if side > 0.0 else LOWER
    pose, velocity = border + side * distance, outwards * side * TOP
    requested = side * TOP
    allowed = limits.braking_time(velocity) + limits.travel_time(pose + side * TOP**2 / ACCELERATION, border)
    steps = list(follow(limits, pose, velocity, requested, PERIOD, math.ceil(allowed / PERIOD) + 2))
    speeds = np.array([velocity, *(velocity for _, velocity in steps)])
    assert np.all(np.abs(np.diff(speeds, axis=0)) <= (1.0 + ROUNDING) * PERIOD * ACCELERATION)
    assert np.all(np.abs(speeds) <= TOP)
    np.testing.assert_allclose(steps[-1][0], border, atol=1e-9)
    np.testing.assert_allclose(steps[-1][1], REST, atol=1e-6)
    assert np.all(side * (steps[-1][0] - border) <= ROUNDING)


def test_arm_with_deviations_stays_inside(limits):
    generator = np.random.default_rng(0)
    stray = np.array([2e-6, 2e-6, 2e-5])  # per period: more than that of the simulated arm at full speed
    limits = MotionLimits.from_config(CONFIG, margin=3e-4)
    for requested in itertools.product(*zip(-TOP, TOP)):
        pose, velocity = BOX.centre, REST
        for _ in range(1000):
            next_velocity = limits.next_velocity(pose, velocity, requested, PERIOD).velocity
            assert np.all(np.abs(np.subtract(next_velocity, velocity)) <= (1.0 + ROUNDING) * PERIOD * ACCELERATION)
            velocity = next_velocity
            pose = pose + PERIOD * np.array(velocity) + stray * generator.uniform(-1.0, 1.0, 3)
            assert BOX.contains(pose)
        np.testing.assert_allclose(BOX.normalise(pose), np.sign(requested), atol=1e-3)


def test_braking_starts_at_braking_distance():
    # 0.9 of the acceleration of 10 is planned with: 0.9 m/s less each period of 0.1 s, which takes 0.18 + 0.09 m.
    limits = MotionLimits([0.0] * 3, [1.0] * 3, [5.0] * 3, [10.0] * 3)
    steps = list(follow(limits, [0.73] * 3, [1.0] * 3, [5.0] * 3, 0.1, 4))
    np.testing.assert_allclose([velocity[0] for _, velocity in steps], [1.8, 0.9, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose([pose[0] for pose, _ in steps], [0.91, 1.0, 1.0, 1.0], atol=1e-12)


@pytest.mark.parametrize(
    ("requested", "ticks"), [((0.1, -0.15, 1.5), 36), ((0.052, 0.0, 0.3), 11), ((0.0, 0.0, 0.0), 1)]
)
def test_legal_velocity_is_reached_at_full_acceleration(limits, requested, ticks):
    velocities = [velocity for _, velocity in follow(limits, BOX.centre, REST, requested, PERIOD, ticks)]
    assert velocities[-1] == requested
    assert all(velocity != requested for velocity in velocities[:-1])


def test_only_speed_limit_and_border_count_as_cut(limits):
    centre = BOX.centre.tolist()
    assert not limits.next_velocity(centre, REST, TOP, PERIOD).limited
    assert limits.next_velocity(centre, REST, 1.02 * TOP, PERIOD).limited
    assert limits.next_velocity(BOX.upper, REST, (0.05, 0.0, 0.0), PERIOD).limited
    assert not limits.next_velocity(BOX.upper, REST, (-0.05, 0.0, 0.0), PERIOD).limited
    assert not limits.next_velocity(np.array(BOX.upper) + 1e-7, REST, REST, PERIOD).limited


@given(velocity=requested_velocities)
def test_velocity_above_limits_keeps_direction(velocity):
    slowed = MotionLimits.from_config(CONFIG).clamp_speed(velocity)
    if np.all(np.abs(velocity) <= TOP):
        assert slowed == velocity
    else:
        assert np.max(np.abs(slowed) / TOP) == pytest.approx(1.0)
        assert np.all(np.abs(slowed) <= TOP)
        largest = max(map(abs, velocity))
        unit, unit_slowed = np.array(velocity) / largest, np.array(slowed) / max(map(abs, slowed))
        np.testing.assert_allclose(unit_slowed, unit, rtol=1e-9, atol=1e-12)


@given(starts=st.tuples(*(st.floats(-1.0, 1.0),) * 3), goals=st.tuples(*(st.floats(-1.0, 1.0),) * 3))
def test_approach_arrives_without_overshoot(starts, goals):
    limits = MotionLimits.from_config(CONFIG)
    pose, target = BOX.denormalise(np.array(starts)), BOX.denormalise(np.array(goals))
    side, velocity = np.sign(target - pose), REST
    for _ in range(math.ceil(limits.travel_time(pose, target) / PERIOD) + 2):
        velocity = limits.next_velocity(pose, velocity, limits.approach(pose, target, PERIOD), PERIOD).velocity
        pose = pose + PERIOD * np.array(velocity)
        assert np.all(side * (pose - target) <= 1e-6 * BOX.scale)
    np.testing.assert_allclose(BOX.normalise(pose), goals, atol=1e-6)


@pytest.mark.parametrize("place", [0, 1, 2])
@given(value=absurd, axis=st.integers(0, 2))
@settings(max_examples=20)
def test_non_finite_number_is_rejected(place, value, axis):
    values = [BOX.centre.tolist(), list(REST), list(REST)]
    values[place][axis] = value
    name = ("pose", "previous velocity", "requested velocity")[place]
    with pytest.raises(CommandError, match=f"^invalid {name} "):
        MotionLimits.from_config(CONFIG).next_velocity(*values, PERIOD)


@pytest.mark.parametrize("requested", [(), (0.1, 0.1), (0.1, 0.1, 0.1, 0.1), None, 0.1])
def test_velocity_of_wrong_length_is_rejected(limits, requested):
    with pytest.raises(CommandError, match=r"invalid requested velocity .*: expected 3 finite numbers"):
        limits.next_velocity(BOX.centre, REST, requested, PERIOD)


@pytest.mark.parametrize("period", [0.0, -0.01, 1e-9, 1.5, math.nan, math.inf])
def test_invalid_period_is_rejected(limits, period):
    with pytest.raises(CommandError, match=r"invalid period .*: expected 1e-06 to 1 s"):
        limits.next_velocity(BOX.centre, REST, REST, period)
