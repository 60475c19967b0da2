"""Conversion between end effector and camera poses, and invalid poses."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.franka.mount import CameraMount, CameraPose
from embodied_active_learning.geometry import quaternion

planes = st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-3.1, 3.1))
tilts = st.tuples(st.floats(-0.7, 0.7), st.floats(-0.7, 0.7))
rotations = st.tuples(*(st.floats(-3.0, 3.0),) * 3)


def column_major(position, rotation):
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = rotation, position
    return transform.T.ravel()


def test_identity_mount_looks_straight_down_at_yaw_zero():
    mount = CameraMount((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.4)
    pose = mount.camera_pose(column_major((0.5, 0.1, 0.42), np.diag([1.0, -1.0, -1.0])))
    assert pose.planar == pytest.approx((0.5, 0.1, 0.0))
    assert pose.height == pytest.approx(0.02)
    assert pose.tilt == pytest.approx((0.0, 0.0))


def test_camera_pose_includes_mount_offset():
    # 5 cm along the hand's x and 3 cm towards the table; the hand turned by 90 degrees, its x along the base's y.
    mount = CameraMount((0.05, 0.0, 0.03), (0.0, 0.0, math.pi), 0.3)
    hand = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    pose = mount.camera_pose(column_major((0.5, 0.0, 0.33), hand))
    assert pose.planar == pytest.approx((0.5, 0.05, -math.pi / 2.0))
    assert pose.height == pytest.approx(0.0)


def test_plane_height_is_table_height_plus_distance():
    mount = CameraMount.from_config(Config.from_dict({"franka": {"table_height": 0.1}, "camera": {"distance": 0.35}}))
    position, _ = mount.end_effector(CameraPose((0.5, 0.0, 0.0), 0.0, (0.0, 0.0)))
    assert position == pytest.approx((0.5, 0.0, 0.45))


@given(planar=planes, height=st.floats(-0.2, 0.2), tilt=tilts, offset=planes, rotation=rotations)
def test_camera_pose_round_trip(planar, height, tilt, offset, rotation):
    mount = CameraMount(offset, rotation, 0.4)
    pose = mount.camera_pose(column_major(*mount.end_effector(CameraPose(planar, height, tilt))))
    np.testing.assert_allclose(pose.planar, planar, atol=1e-9)
    assert pose.height == pytest.approx(height, abs=1e-9)
    np.testing.assert_allclose(pose.tilt, tilt, atol=1e-9)
    assert pose.tilt_angle == pytest.approx(math.hypot(*tilt), abs=1e-9)


@given(rotation=rotations)
def test_quaternion_represents_rotation(rotation):
    matrix = CameraMount((0.0, 0.0, 0.0), rotation, 0.0)._rotation
    x, y, z, w = quaternion(matrix)
    assert x * x + y * y + z * z + w * w == pytest.approx(1.0)
    again = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    np.testing.assert_allclose(again, matrix, atol=1e-12)


@pytest.mark.parametrize(
    ("end_effector", "complaint"),
    [
        (np.full(16, math.nan), "not finite"),
        (np.zeros(16), "not orthonormal"),
        (column_major((0.5, 0.0, 0.4), np.eye(3)), "looks up"),
    ],
)
def test_invalid_end_effector_pose_is_rejected(end_effector, complaint):
    with pytest.raises(ObservationError, match=complaint):
        CameraMount((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.4).camera_pose(end_effector)
