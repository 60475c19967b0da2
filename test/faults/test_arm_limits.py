"""The simulated arm respects workspace, speed and acceleration limits for any command.

Verified by the true pose of its body after every physics step.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from arms import arm_at_start, assert_upright
from embodied_active_learning.config import Config, SimulationConfig
from embodied_active_learning.errors import CommandError
from embodied_active_learning.simulation import servo

CONFIG = Config()
BOX = CONFIG.workspace.box()
TOP_SPEED = np.array([0.15, 0.15, 1.5])
ACCELERATION = np.array([1.2, 1.2, 10.0])
# rad/s^2: what libfranka's rate limiter lets the joints of a Panda do
JOINT_ACCELERATION = np.array([15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0])
# Tracking error at full speed as a fraction of the limits ...
TOLERANCE = 0.02
# ... and resolution of PyBullet's poses (single precision), which affects their differences.
RESOLUTION = np.array([6e-8, 6e-8, 3e-7])


class Recorder:
    """Records the true pose and the joint velocities of every physics step."""

    def __init__(self, arm):
        self._body, self._drive = arm._body, arm._body.drive
        self.poses = [self._pose()] * 2  # at rest
        self.joint_velocities = [np.zeros(len(JOINT_ACCELERATION))]
        self._body.drive = self._drive_and_record

    def end(self):
        del self._body.drive  # leaves that of its class

    def _drive_and_record(self, joints, joint_velocities):
        self._drive(joints, joint_velocities)
        self.joint_velocities.append(joint_velocities)
        self.poses.append(self._pose())

    def _pose(self):
        position, orientation, _ = self._body.optical_frame()
        return servo.planar_pose(position, orientation)

    def assert_all_limits_kept(self):
        velocities = np.diff(self.poses, axis=0) / self._body.period
        accelerations = np.diff(velocities, axis=0) / self._body.period
        assert np.all(BOX.contains(np.array(self.poses)))
        assert_within(velocities, TOP_SPEED, RESOLUTION / self._body.period)
        assert_within(accelerations, ACCELERATION, 2.0 * RESOLUTION / self._body.period**2)

    def assert_no_joint_near_its_limit(self):
        accelerations = np.diff(self.joint_velocities, axis=0) / self._body.period
        assert_within(accelerations, 0.85 * JOINT_ACCELERATION, 0.0)


def assert_within(values, limit, unresolved):
    largest = np.max(np.abs(values), axis=0, initial=0.0)
    assert np.all(largest <= (1.0 + TOLERANCE) * limit + unresolved), largest


@contextlib.contextmanager
def recorded_arm(config=CONFIG):
    """Yield an arm and the recorder of its motion; check the limits at the end."""
    arm = arm_at_start(config)
    recorder = Recorder(arm)
    try:
        yield arm, recorder
        recorder.assert_all_limits_kept()
    finally:
        recorder.end()


anything = st.one_of(
    st.floats(), st.sampled_from([1e308, -1e308, 5e-324, math.nan, math.inf, 10**400, None, "1", b"", ()])
)
legal_velocities = st.tuples(*(st.floats(-1.5 * top, 1.5 * top) for top in TOP_SPEED))
velocities = st.one_of(
    legal_velocities,
    st.sampled_from(list(itertools.product(*zip(-TOP_SPEED, TOP_SPEED)))),
    st.tuples(*(st.floats(allow_nan=False, allow_infinity=False),) * 3),
    st.lists(anything, max_size=4),
    anything,
)
durations = st.one_of(st.floats(0.001, 0.5), anything)
errors = st.one_of(st.none(), st.tuples(*(st.floats(-10.0 * top, 10.0 * top) for top in TOP_SPEED)))
poses = st.one_of(
    st.tuples(*(st.floats(low, high) for low, high in zip(BOX.lower, BOX.upper))),
    st.sampled_from(list(itertools.product(*zip(BOX.lower, BOX.upper)))),
    st.lists(anything, max_size=4),
    anything,
)
commands = st.one_of(
    st.tuples(st.just("move"), velocities, durations, errors),
    st.tuples(st.just("go_to"), poses),
    st.tuples(st.just("stop")),
)


def state_of(arm):
    return [*arm.pose, *arm.velocity, arm.time, *arm.joint_positions.values(), *arm.joint_velocities.values()]


def send(arm, command, *arguments):
    """Send one command; if it is rejected, the arm must be unchanged."""
    before = state_of(arm)
    if command == "move":
        velocity, duration, error = arguments
        arguments = velocity, duration, None if error is None else lambda: np.array(error)
    rejection = None
    try:
        getattr(arm, command)(*arguments)
    except CommandError as error:
        rejection = str(error)
    if rejection is not None:
        assert "invalid " in rejection
        np.testing.assert_array_equal(state_of(arm), before)


@given(st.lists(commands, min_size=1, max_size=8))
@example(
    [("move", tuple(TOP_SPEED), 0.5, None), ("go_to", BOX.lower), ("move", tuple(TOP_SPEED), 0.3, None), ("stop",)]
)
def test_no_command_sequence_violates_limits(sequence):
    with recorded_arm() as (arm, _):
        for command in sequence:
            send(arm, *command)
            assert_upright(arm)


@pytest.mark.parametrize("seed", range(2))
def test_noisy_arm_respects_limits(seed):
    generator = np.random.default_rng(seed)
    with recorded_arm() as (arm, _):
        for _ in range(50):
            wanted = generator.uniform(-2.0, 2.0, 3) * TOP_SPEED
            arm.move(wanted, generator.uniform(0.005, 0.4), lambda: generator.standard_normal(3) * TOP_SPEED)


def test_default_limits_leave_joint_acceleration_reserve():
    generator = np.random.default_rng(0)
    with recorded_arm() as (arm, recorder):
        for corner in itertools.product(*zip(BOX.lower, BOX.upper)):
            arm.go_to(corner)
            for _ in range(20):
                arm.move(generator.choice([-1.0, 1.0], 3) * TOP_SPEED, 0.3)
        recorder.assert_no_joint_near_its_limit()


@pytest.mark.parametrize(("rate", "direction"), [(60, (1, 1, 1)), (240, (1, -1, 1)), (1000, (-1, 1, -1))])
def test_full_speed_into_corner_stops_inside(rate, direction):
    config = dataclasses.replace(CONFIG, simulation=SimulationConfig(physics_rate=rate))
    with recorded_arm(config) as (arm, _):
        limited = [arm.move(np.array(direction) * TOP_SPEED, 0.48).limited for _ in range(4)]
        assert limited == [False, False, True, True]
        np.testing.assert_allclose(BOX.normalise(arm.pose), direction, atol=1e-3)
        np.testing.assert_allclose(arm.velocity, np.zeros(3), atol=1e-2)
        assert abs(arm.camera_height - CONFIG.camera.distance) < 1e-3
        assert arm.tilt < 0.005


@pytest.mark.parametrize("rate", [60, 240])
def test_go_to_while_moving_away_does_not_overshoot(rate):
    config = dataclasses.replace(CONFIG, simulation=SimulationConfig(physics_rate=rate))
    with recorded_arm(config) as (arm, recorder):
        arm.move((0.15, 0.15, -1.5), 0.3)
        goal = (0.35, -0.12, 1.8)
        result = arm.go_to(goal)
        assert not result.limited
        np.testing.assert_allclose(result.velocity, np.zeros(3), atol=1e-3)
        beyond = (np.array(recorder.poses) - goal) * [-1, -1, 1]
        assert np.all(beyond <= [1e-5, 1e-5, 1e-4])
