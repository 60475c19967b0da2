"""From planar velocities to joint velocities: numbers worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from embodied_active_learning.simulation import servo

PERIOD = 0.01  # s
MIDDLE = servo.JOINT_LIMITS[:, :2].mean(axis=1)
UPRIGHT = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))  # Rx(pi)


def test_legal_joint_velocities_keep_all_of_their_speed():
    assert servo.share_within_limits(0.9 * servo.JOINT_LIMITS[:, 2], MIDDLE, PERIOD) == 1.0
    assert servo.share_within_limits(np.zeros(7), MIDDLE, PERIOD) == 1.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_joint_that_exceeds_its_speed_most_slows_all_joints(sign):
    factors = np.array([0.1, 2.0, 0.5, 4.0, 1.0, 3.0, 0.0])
    share = servo.share_within_limits(sign * factors * servo.JOINT_LIMITS[:, 2], MIDDLE, PERIOD)
    assert share == pytest.approx(0.25)


@pytest.mark.parametrize(("limit", "direction"), [(0, -1.0), (1, 1.0)])
def test_a_joint_close_to_its_limit_may_go_no_further_than_that_limit_in_one_period(limit, direction):
    joints, velocities = MIDDLE.copy(), np.zeros(7)
    joints[2] = servo.JOINT_LIMITS[2, limit] - direction * 0.002
    velocities[2] = direction * 0.8
    assert servo.share_within_limits(velocities, joints, PERIOD) == pytest.approx(0.002 / PERIOD / 0.8)
    assert servo.share_within_limits(-velocities, joints, PERIOD) == 1.0


def test_a_joint_beyond_its_limit_may_only_come_back():
    joints, velocities = MIDDLE.copy(), np.zeros(7)
    joints[0] = servo.JOINT_LIMITS[0, 1] + 1e-4
    velocities[0] = 0.1
    assert servo.share_within_limits(velocities, joints, PERIOD) == 0.0
    assert servo.share_within_limits(-velocities, joints, PERIOD) == 1.0


def test_a_camera_that_hangs_low_and_level_climbs_without_turning():
    twist = servo.held_twist((0.1, -0.2, 0.3), (0.5, 0.0, 0.29), UPRIGHT, 0.3)
    np.testing.assert_allclose(twist, [0.1, -0.2, 20.0 * 0.01, 0.0, 0.0, 0.3], atol=1e-12)


def test_a_tilted_camera_turns_back_about_the_axis_that_it_is_tilted_about():
    angle = 0.01
    cosine, sine = np.cos(angle), np.sin(angle)
    tilted = ((1.0, 0.0, 0.0), (0.0, -cosine, sine), (0.0, -sine, -cosine))  # Rx(angle) Rx(pi)
    twist = servo.held_twist((0.0, 0.0, 0.0), (0.5, 0.0, 0.3), tilted, 0.3)
    np.testing.assert_allclose(twist, [0.0, 0.0, 0.0, -20.0 * sine, 0.0, 0.0], atol=1e-12)
