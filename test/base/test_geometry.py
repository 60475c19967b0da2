"""Planar geometry: pixels show the points that the camera matrix says, and motions of poses are rigid."""

from __future__ import annotations

import math

import numpy as np
import pybullet
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.geometry import (
    field_of_view,
    intrinsics,
    metres_per_pixel,
    optical_rotation,
    pixels_of,
    pose_distance,
    rotation_matrix,
    table_points,
    transform_poses,
    wrap,
)
from embodied_active_learning.simulation.scene import Scene
from embodied_active_learning.simulation.world import load_world
from embodied_active_learning.workspace import Workspace

POSES = st.tuples(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0), st.floats(-math.pi, math.pi)).map(np.array)
CAMERAS = (CameraConfig(), CameraConfig(width=201, height=120, field_of_view=47.0, distance=0.41))


def matrix(pose):
    """(3, 3) homogeneous transform of a planar pose."""
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    return np.array([[cosine, -sine, pose[0]], [sine, cosine, pose[1]], [0.0, 0.0, 1.0]])


def project(point, state, camera):
    """(row, column) of a point of the table (2,) [m] for a camera state (3,), by camera matrix and orientation."""
    in_camera = optical_rotation(state[2]).T @ [point[0] - state[0], point[1] - state[1], -camera.distance]
    column, row, depth = intrinsics(camera.width, camera.height, camera.field_of_view) @ in_camera
    return row / depth, column / depth


def assert_same_pose(found, expected):
    distance, turn = pose_distance(found, np.asarray(expected))
    assert np.all(distance < 1e-9)
    assert np.all(turn < 1e-9)


@pytest.mark.parametrize("camera", CAMERAS)
@given(POSES, st.floats(0.0, 200.0), st.floats(0.0, 200.0))
def test_pixel_to_point_and_back_is_identity(camera, state, row, column):
    point = table_points(state, np.float64(row), np.float64(column), camera)
    assert project(point, state, camera) == pytest.approx((row, column), abs=1e-6)


@pytest.mark.parametrize("camera", CAMERAS)
@given(POSES, st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_pixel_of_point_matches_camera_matrix(camera, state, x, y):
    point = np.add(state[:2], (x, y))
    assert pixels_of(state, point, camera) == pytest.approx(project(point, state, camera), abs=1e-6)


def test_pixels_of_broadcasts_points_and_states():
    states, points = np.random.default_rng(0).uniform(-0.5, 0.5, (7, 3)), np.random.default_rng(1).random((7, 2))
    for index, state in enumerate(states):
        one, many = pixels_of(states, points[0], CAMERAS[1]), pixels_of(states, points, CAMERAS[1])
        assert (one[0][index], one[1][index]) == pytest.approx(project(points[0], state, CAMERAS[1]))
        assert (many[0][index], many[1][index]) == pytest.approx(project(points[index], state, CAMERAS[1]))


def test_pixel_size_equals_distance_of_neighbours():
    for camera in CAMERAS:
        points = table_points(np.array([0.4, 0.1, 0.7]), np.array([3, 3, 4]), np.array([5, 6, 5]), camera)
        apart = np.linalg.norm(points[1:] - points[0], axis=1)
        assert apart == pytest.approx([metres_per_pixel(camera)] * 2, rel=1e-12)


def test_small_object_appears_in_its_pixel(tmp_path):
    world = tmp_path / "mine.yaml"
    address = "package://embodied_active_learning/worlds/models/star/star.urdf"
    world.write_text(
        f"table: {{colour: [0, 0, 1]}}\nobjects: {{a: {{urdf: '{address}', position: [0.493, -0.011], scale: 0.25}}}}",
        encoding="utf-8",
    )
    camera = CameraConfig(width=201, height=120)
    scene = Scene(load_world(str(world), Workspace()), camera)
    try:
        states = np.array([[0.475, 0.0, 0.0], [0.47, 0.01, 1.3], [0.52, -0.03, -2.0], [0.46, 0.015, 3.0]])
        for state in states:
            points = table_points(state, *np.mgrid[0:120, 0:201], camera)
            assert points.shape == (120, 201, 2)
            shown = np.any(scene.render(state) != (0, 0, 255), axis=2)
            assert 30 < shown.sum() < 2000
            middle = (points[shown].min(axis=0) + points[shown].max(axis=0)) / 2.0
            np.testing.assert_allclose(middle, scene.objects[0].centre, atol=0.003)
    finally:
        scene.close()


@given(st.floats(-100.0, 100.0))
def test_wrapped_angle_is_equivalent_and_in_range(angle):
    wrapped = wrap(angle)
    assert -math.pi <= wrapped < math.pi
    assert math.cos(wrapped - angle) == pytest.approx(1.0)
    assert math.sin(wrapped - angle) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    "angle", [math.pi, -math.pi, 3 * math.pi, np.nextafter(-math.pi, -4), np.nextafter(math.pi, 0)]
)
def test_wrapped_angle_is_below_pi(angle):
    assert -math.pi <= wrap(angle) < math.pi


@given(POSES, POSES, POSES)
def test_move_matches_homogeneous_transforms(pose, origin, goal):
    moved = matrix(goal) @ np.linalg.inv(matrix(origin)) @ matrix(pose)
    expected = (moved[0, 2], moved[1, 2], math.atan2(moved[1, 0], moved[0, 0]))
    assert_same_pose(transform_poses(pose, origin, goal), expected)


@settings(max_examples=20)
@given(st.integers(0, 2**31 - 1))
def test_move_broadcasts_poses(seed):
    poses, origins, goals = np.random.default_rng(seed).uniform(-3, 3, (3, 4, 5, 3))
    moved = transform_poses(poses, origins, goals)
    for index in np.ndindex(4, 5):
        np.testing.assert_allclose(
            moved[index], transform_poses(poses[index], origins[index], goals[index]), atol=1e-12
        )
    np.testing.assert_allclose(
        transform_poses(poses[0, 0], origins, goals)[2, 3], transform_poses(poses[0, 0], origins[2, 3], goals[2, 3])
    )


def test_pose_distance_takes_smallest_turn():
    distance, turn = pose_distance(np.array([3.0, 0.0, 3.0]), np.array([0.0, 4.0, -3.0]))
    assert distance == pytest.approx(5.0)
    assert turn == pytest.approx(2 * math.pi - 6.0)


@pytest.mark.parametrize("camera", CAMERAS)
def test_camera_matrix_gives_field_of_view(camera):
    matrix = intrinsics(camera.width, camera.height, camera.field_of_view)
    assert field_of_view(matrix, camera.height) == pytest.approx(camera.field_of_view)


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda values: np.linalg.norm(values) > 0.01))
def test_quaternion_rotation_matches_pybullet(values):
    unit = values / np.linalg.norm(values)
    expected = np.reshape(pybullet.getMatrixFromQuaternion(unit), (3, 3))
    np.testing.assert_allclose(rotation_matrix(*unit), expected, atol=1e-9)
