"""The simulated arm executes commands within its limits."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest

from arms import arm_at_start, assert_upright
from embodied_active_learning.config import ArmConfig, CameraConfig, Config, WorkspaceConfig
from embodied_active_learning.errors import CommandError, ConfigError
from embodied_active_learning.simulation.arm import SimulatedArm
from embodied_active_learning.simulation.panda import ARM_JOINTS
from embodied_active_learning.simulation.servo import JOINT_LIMITS

CONFIG = Config()
BOX = CONFIG.workspace.box()
FULL_SPEED = np.array([0.15, 0.15, 1.5])
ACCELERATION = np.array([1.2, 1.2, 10.0])


@pytest.fixture
def arm():
    return arm_at_start(CONFIG)


def test_arm_starts_at_rest_at_configured_pose():
    arm = SimulatedArm(CONFIG)
    np.testing.assert_allclose(arm.pose, CONFIG.simulation.start, atol=1e-5)
    np.testing.assert_array_equal(arm.velocity, np.zeros(3))
    assert arm.time == 0.0
    assert_upright(arm)
    arm.close()


@pytest.mark.parametrize("velocity", [(0.1, 0, 0), (0, -0.1, 0), (0, 0, 1.2), (0.06, -0.07, 0.9), tuple(FULL_SPEED)])
def test_velocity_is_tracked_within_half_a_percent(arm, velocity):
    arm.move(velocity, 0.2)
    before = arm.pose
    result = arm.move(velocity, 0.2)
    assert not result.limited
    np.testing.assert_allclose(result.state - before, 0.2 * np.array(velocity), atol=0.005 * 0.2 * 0.15)
    np.testing.assert_allclose(result.velocity, velocity, atol=0.005 * 0.15)
    np.testing.assert_array_equal(result.state, arm.pose)
    assert_upright(arm)


def test_joint_velocities_match_positions(arm):
    arm.move((0.1, 0.05, 0.5), 0.2)
    before, velocity = arm.joint_positions, arm.joint_velocities
    assert set(before) == set(ARM_JOINTS)
    arm.move((0.1, 0.05, 0.5), 1 / 240)
    for name in before:
        assert 240 * (arm.joint_positions[name] - before[name]) == pytest.approx(velocity[name], abs=0.01)


def test_go_to_reaches_all_corners(arm):
    for corner in itertools.product(*zip(BOX.lower, BOX.upper)):
        result = arm.go_to(corner)
        np.testing.assert_allclose(result.state[:2], corner[:2], atol=2e-4)
        np.testing.assert_allclose(result.state[2], corner[2], atol=2e-3)
        np.testing.assert_allclose(result.velocity, np.zeros(3), atol=1e-3)
        assert BOX.contains(result.state)
        assert_upright(arm)


def test_go_to_respects_speed_limits(arm):
    start = arm.pose
    result = arm.go_to((0.6, 0.1, 1.5))
    assert not result.limited
    assert arm.time >= np.max(np.abs(result.state - start) / FULL_SPEED)
    assert arm.time <= 0.5 + np.max(np.abs(result.state - start) / FULL_SPEED)


def test_too_fast_move_keeps_direction(arm):
    arm.move((0.6, 0.3, 0.0), 0.2)
    before = arm.pose
    result = arm.move((0.6, 0.3, 0.0), 0.2)
    assert result.limited
    np.testing.assert_allclose(result.state - before, [0.03, 0.015, 0.0], atol=2e-4)


@pytest.mark.parametrize(
    ("velocity", "duration"),
    [
        ((math.nan, 0, 0), 0.2),
        ((0.1, 0, 0), 1.1),
        ((0.1, 0, 0), None),
    ],
)
def test_invalid_move_is_rejected(arm, velocity, duration):
    arm.move((0.05, 0.0, 0.3), 0.1)
    pose, speed, time = arm.pose, arm.velocity, arm.time
    with pytest.raises(CommandError, match=r"^invalid "):
        arm.move(velocity, duration)
    np.testing.assert_array_equal(arm.pose, pose)
    np.testing.assert_array_equal(arm.velocity, speed)
    assert arm.time == time


@pytest.mark.parametrize("pose", [(0.7, 0, 0), (0.475, 0, 2.1), (math.nan, 0, 0), (0.475, 0)])
def test_invalid_pose_is_rejected(arm, pose):
    before = arm.pose
    with pytest.raises(CommandError, match=r"^invalid "):
        arm.go_to(pose)
    np.testing.assert_array_equal(arm.pose, before)
    assert arm.time == 0.0


def test_stop_brakes_at_acceleration_limit(arm):
    arm.move(FULL_SPEED, 0.3)
    before = arm.time
    result = arm.stop()
    np.testing.assert_allclose(result.velocity, np.zeros(3), atol=1e-3)
    assert arm.time - before == pytest.approx(np.max(FULL_SPEED / ACCELERATION), abs=0.01)


def test_limited_only_if_velocity_is_not_reached(arm):
    needed = FULL_SPEED[0] / ACCELERATION[0]
    assert arm.move((FULL_SPEED[0], 0.0, 0.0), 0.8 * needed).limited
    assert not arm.move((FULL_SPEED[0], 0.0, 0.0), 0.4 * needed).limited
    assert arm.move((-FULL_SPEED[0], 0.0, 0.0), 1.8 * needed).limited
    assert not arm.move((-FULL_SPEED[0], 0.0, 0.0), 0.4 * needed).limited


def test_moves_join_without_a_stop(arm):
    arm.move((0.1, 0.0, 0.0), 0.2)
    before = arm.pose
    np.testing.assert_allclose(arm.move((0.1, 0.0, 0.0), 1 / 240).state[0] - before[0], 0.1 / 240, rtol=0.01)


def test_no_limit_at_rest_on_border(arm):
    arm.go_to(BOX.upper)
    assert not arm.move((0.0, 0.0, 0.0), 0.2).limited
    assert not arm.move((-0.05, 0.0, 0.0), 0.2).limited
    assert not arm.go_to((BOX.lower[0], BOX.upper[1], 0.0)).limited


def test_time_counts_physics_steps(arm):
    for _ in range(30):
        arm.move((0.0, 0.0, 0.1), 0.1)
    assert arm.time == 720 / 240
    arm.move((0.0, 0.0, 0.1), 1e-6)
    assert arm.time == 721 / 240


def test_zero_velocity_holds_pose(arm):
    arm.go_to((0.35, 0.12, -1.5))
    before = arm.pose
    for _ in range(5):
        arm.move((0, 0, 0), 1.0)
    np.testing.assert_allclose(arm.pose, before, atol=1e-4)
    assert_upright(arm)


def test_two_arms_are_independent(arm):
    other = SimulatedArm(CONFIG)
    other.move((0.1, 0, 0), 0.5)
    np.testing.assert_allclose(arm.pose, CONFIG.simulation.start, atol=1e-5)
    assert arm.time == 0.0
    other.close()
    assert arm.move((0, 0.1, 0), 0.2).state[1] > 0.01


@pytest.mark.parametrize(
    "config",
    [
        dataclasses.replace(CONFIG, workspace=WorkspaceConfig(x=(0.325, 1.2))),
        dataclasses.replace(CONFIG, workspace=WorkspaceConfig(theta=(-3.1, 3.1))),
        # every corner can be reached, the middle of the edge next to the base cannot
        dataclasses.replace(CONFIG, workspace=WorkspaceConfig(x=(0.2, 0.5), y=(-0.4, 0.4), theta=(-1.0, 1.0))),
        dataclasses.replace(CONFIG, camera=CameraConfig(distance=1.8)),
    ],
)
def test_unreachable_workspace_is_rejected(config):
    with pytest.raises(ConfigError, match="the Panda cannot hold its camera at"):
        SimulatedArm(config)


def test_joint_speed_limits_take_precedence():
    limits = ArmConfig(max_speed=1.0, max_turn_rate=2.6, max_acceleration=13.0, max_turn_acceleration=25.0)
    arm = SimulatedArm(dataclasses.replace(CONFIG, arm=limits))
    arm.go_to((0.475, 0.15, -1.0))
    result = arm.move((0.0, -1.0, 2.6), 0.15)
    assert result.limited
    speeds = np.array([arm.joint_velocities[name] for name in ARM_JOINTS])
    assert 0.99 <= np.max(np.abs(speeds) / JOINT_LIMITS[:, 2]) <= 1.001
    arm.close()


def assert_same(state, expected):
    assert state.keys() == expected.keys()
    for name, array in expected.items():
        np.testing.assert_array_equal(state[name], array)


def test_load_state_dict_continues_bit_for_bit(arm):
    velocities = [(0.1, 0.05, 0.5), (-0.15, 0.15, -1.5), (0.0, 0.3, 0.0), (0.15, 0.15, 1.5), (0.0, 0.0, -1.0)]
    for velocity in velocities[:2]:
        arm.move(velocity, 0.2)
    state = arm.state_dict()
    expected = [arm.move(velocity, 0.2) for velocity in velocities[2:]]
    other = SimulatedArm(CONFIG)
    try:
        for one in (arm, other):
            one.go_to((0.4, -0.1, 1.0))
            one.load_state_dict(state)
            assert_same(one.state_dict(), state)
            for velocity, result in zip(velocities[2:], expected):
                again = one.move(velocity, 0.2)
                np.testing.assert_array_equal(again.state, result.state)
                np.testing.assert_array_equal(again.velocity, result.velocity)
    finally:
        other.close()


@pytest.mark.parametrize(
    ("name", "index", "value", "reason"),
    [
        ("steps", 0, -1.0, "time out of range"),
        ("steps", 0, 1e300, "time out of range"),
        ("joints", 0, 1.0, "outside the workspace"),
        ("joints", 1, math.nan, "joints must be 7 finite numbers"),
        ("joints", 6, 3.4, "joint positions out of range"),
        ("joint_velocities", 3, 1e300, "joint velocities out of range"),
        ("joint_velocities", 3, -2.3, "joint velocities out of range"),
        ("commanded", 0, 1e9, "commanded velocity out of range"),
        ("commanded", 2, -1.6, "commanded velocity out of range"),
    ],
)
def test_load_state_dict_rejects_illegal_values(arm, name, index, value, reason):
    """A rejected state leaves the arm as it was."""
    arm.move((0.1, 0.0, 0.0), 0.2)
    before, pose = arm.state_dict(), arm.pose
    wrong = {key: array.copy() for key, array in before.items()}
    wrong[name][index] = value
    with pytest.raises(CommandError, match=f"arm state rejected: .*{reason}"):
        arm.load_state_dict(wrong)
    assert_same(arm.state_dict(), before)
    np.testing.assert_array_equal(arm.pose, pose)


def test_load_state_dict_rejects_other_fields_and_shapes(arm):
    state = arm.state_dict()
    with pytest.raises(CommandError, match=r"fields are \['steps'\], expected"):
        arm.load_state_dict({"steps": state["steps"]})
    with pytest.raises(CommandError, match="joints must be 7 finite numbers"):
        arm.load_state_dict({**state, "joints": np.zeros(2)})
