"""Servo control against values computed by hand."""

from __future__ import annotations

import numpy as np
import pytest

from embodied_active_learning.simulation import servo

PERIOD = 0.01  # s
MIDDLE = servo.JOINT_LIMITS[:, :2].mean(axis=1)
UPRIGHT = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))  # Rx(pi)


def test_legal_joint_velocities_are_unchanged():
    assert servo.scale_within_limits(0.9 * servo.JOINT_LIMITS[:, 2], MIDDLE, PERIOD) == 1.0
    assert servo.scale_within_limits(np.zeros(7), MIDDLE, PERIOD) == 1.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_fastest_joint_slows_all_joints(sign):
    factors = np.array([0.1, 2.0, 0.5, 4.0, 1.0, 3.0, 0.0])
    scale = servo.scale_within_limits(sign * factors * servo.JOINT_LIMITS[:, 2], MIDDLE, PERIOD)
    assert scale == pytest.approx(0.25)


@pytest.mark.parametrize(("limit", "direction"), [(0, -1.0), (1, 1.0)])
def test_joint_stops_at_its_limit_within_one_period(limit, direction):
    joints, velocities = MIDDLE.copy(), np.zeros(7)
    joints[2] = servo.JOINT_LIMITS[2, limit] - direction * 0.002
    velocities[2] = direction * 0.8
    assert servo.scale_within_limits(velocities, joints, PERIOD) == pytest.approx(0.002 / PERIOD / 0.8)
    assert servo.scale_within_limits(-velocities, joints, PERIOD) == 1.0


def test_joint_beyond_limit_may_only_return():
    joints, velocities = MIDDLE.copy(), np.zeros(7)
    joints[0] = servo.JOINT_LIMITS[0, 1] + 1e-4
    velocities[0] = 0.1
    assert servo.scale_within_limits(velocities, joints, PERIOD) == 0.0
    assert servo.scale_within_limits(-velocities, joints, PERIOD) == 1.0


def test_low_camera_climbs_without_turning():
    twist = servo.held_twist((0.1, -0.2, 0.3), (0.5, 0.0, 0.29), UPRIGHT, 0.3)
    np.testing.assert_allclose(twist, [0.1, -0.2, 20.0 * 0.01, 0.0, 0.0, 0.3], atol=1e-12)


def test_tilt_is_corrected_about_its_axis():
    angle = 0.01
    cosine, sine = np.cos(angle), np.sin(angle)
    tilted = ((1.0, 0.0, 0.0), (0.0, -cosine, sine), (0.0, -sine, -cosine))  # Rx(angle) Rx(pi)
    twist = servo.held_twist((0.0, 0.0, 0.0), (0.5, 0.0, 0.3), tilted, 0.3)
    np.testing.assert_allclose(twist, [0.0, 0.0, 0.0, -20.0 * sine, 0.0, 0.0], atol=1e-12)
