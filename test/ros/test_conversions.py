"""Conversion between messages and arrays, without a master."""

from contextlib import suppress
from io import BytesIO

import numpy as np
import pytest
import rospy
from hypothesis import given
from hypothesis import strategies as st
from sensor_msgs import point_cloud2
from sensor_msgs.msg import Image

from embodied_active_learning.errors import ObservationError
from embodied_active_learning.ros import conversions, names
from embodied_active_learning.ros.camera.pose_buffer import interpolate
from embodied_active_learning.ros.rviz.markers import OBJECT_COLOUR, disc_marker
from embodied_active_learning.workspace import Workspace

STAMP = rospy.Time(12, 345)


def picture(height=4, width=6):
    return np.arange(height * width * 3, dtype=np.uint8).reshape(height, width, 3)


def test_image_round_trip():
    message = conversions.image_message(STAMP, picture())
    np.testing.assert_array_equal(conversions.image_array(message, 4, 6), picture())
    assert message.header.stamp == STAMP


def test_bgr8_image_converted_to_rgb():
    message = conversions.image_message(STAMP, picture())
    message.encoding = "bgr8"
    np.testing.assert_array_equal(conversions.image_array(message, 4, 6), picture()[..., ::-1])


def test_image_with_padded_rows():
    message = conversions.image_message(STAMP, picture())
    message.data = b"".join(row.tobytes() + b"##" for row in picture())
    message.step += 2
    np.testing.assert_array_equal(conversions.image_array(message, 4, 6), picture())


def test_joint_state_keeps_position_and_velocity():
    message = conversions.joint_state_message(STAMP, {"elbow": 0.5, "wrist": -1.0}, {"wrist": 0.2, "elbow": 0.1})
    assert message.header.stamp == STAMP
    assert list(zip(message.name, message.position, message.velocity)) == [("elbow", 0.5, 0.1), ("wrist", -1.0, 0.2)]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"encoding": "mono8"}, "image encoding is 'mono8'"),
        ({"width": 640, "height": 480}, "image is 640 x 480 pixels, the model takes 6 x 4"),
        ({"data": b""}, "image has 0 bytes"),
        ({"step": 7}, "rows of 7"),
    ],
)
def test_image_that_does_not_fit_rejected(change, expected):
    message = conversions.image_message(STAMP, picture())
    for name, value in change.items():
        setattr(message, name, value)
    with pytest.raises(ObservationError) as refusal:
        conversions.image_array(message, 4, 6)
    assert expected in str(refusal.value)


@given(
    st.integers(0, 2**32 - 1) | st.just(4),
    st.integers(0, 2**32 - 1) | st.just(6),
    st.integers(0, 2**32 - 1) | st.just(18),
    st.sampled_from(["rgb8", "bgr8", "mono8", ""]),
    st.binary(max_size=80) | st.just(bytes(72)),
)
def test_any_image_is_converted_or_rejected(height, width, step, encoding, data):
    message = Image(height=height, width=width, step=step, encoding=encoding, data=data)
    with suppress(ObservationError):
        assert conversions.image_array(message, 4, 6).shape == (4, 6, 3)


@given(st.lists(st.floats(-10, 10), min_size=6, max_size=6))
def test_state_round_trip(values):
    message = conversions.state_message(STAMP, values[:3], values[3:])
    state, velocity = conversions.state_arrays(message)
    assert state.tolist() == values[:3]
    assert velocity.tolist() == values[3:]
    assert message.header.frame_id == "panda_link0"


@pytest.mark.parametrize("values", [[1.0], [0.0, 1.0, float("nan")], [0.0, 1.0, float("inf")]])
def test_malformed_states_rejected(values):
    with pytest.raises(ObservationError):
        conversions.states_array(values)


def test_cloud_contains_points_and_values():
    points, values = np.random.default_rng(0).random((5, 3)), np.arange(5.0)
    cloud = conversions.cloud_message(STAMP, points, values)
    read = np.array(list(point_cloud2.read_points(cloud, ("x", "y", "z", "intensity"))))
    np.testing.assert_allclose(read, np.column_stack([points, values]), rtol=1e-6)
    assert cloud.header.frame_id == "panda_link0"


def test_path_contains_positions_and_headings():
    path = conversions.path_message(STAMP, np.array([[0.4, 0.1, np.pi / 2]]), 0.3)
    pose = path.poses[0].pose
    assert (pose.position.x, pose.position.y, pose.position.z) == (0.4, 0.1, 0.3)
    assert pose.orientation.z == pytest.approx(np.sqrt(0.5))
    assert path.header.frame_id == "panda_link0"


def test_grid_layout_and_origin():
    values = np.array([[0.0, 0.2], [0.5, 1.0], [0.004, 0.996]])
    grid = conversions.occupancy_grid_message(STAMP, values, 0.35, -0.1, 0.1)
    assert (grid.info.width, grid.info.height, grid.info.resolution) == (3, 2, 0.1)
    assert grid.data == [0, 50, 0, 20, 100, 100]
    corner = grid.info.origin.position
    assert (corner.x, corner.y, corner.z) == pytest.approx((0.3, -0.15, 0.0))
    assert grid.info.origin.orientation.w == 1.0
    assert (grid.header.frame_id, grid.header.stamp) == ("panda_link0", STAMP)


@given(st.floats(-1.0, 2.0))
def test_grid_values_clipped_to_0_and_100(value):
    grid = conversions.occupancy_grid_message(STAMP, np.full((1, 1), value), 0.0, 0.0, 0.1)
    assert grid.data == [round(100.0 * min(max(value, 0.0), 1.0))]
    grid.serialize(BytesIO())


def test_workspace_marker_has_twelve_edges():
    marker = conversions.workspace_marker(Workspace(), 0.3)
    assert len(marker.points) == 24
    assert marker.header.frame_id == "panda_link0"


def test_state_interpolation_takes_shorter_rotation():
    before = conversions.state_message(rospy.Time(1), [0.4, 0.0, 3.0], [0, 0, 0])
    after = conversions.state_message(rospy.Time(2), [0.5, 0.1, -3.0], [1, 0, 0])
    state, velocity = conversions.state_arrays(interpolate(before, after, rospy.Time(1, 500000000)))
    np.testing.assert_allclose(state, [0.45, 0.05, np.pi], atol=1e-9)
    np.testing.assert_allclose(velocity, [0.5, 0, 0])


@pytest.fixture
def fr3():
    """A robot whose base stands 5 cm above its table."""
    names.FRAMES.use_robot("fr3", -0.05)
    yield
    names.FRAMES.use_robot("panda", 0.0)


def test_frames_follow_arm_id(fr3):
    assert conversions.state_message(STAMP, (0.5, 0.0, 0.0), (0.0, 0.0, 0.0)).header.frame_id == "fr3_link0"
    assert names.FRAMES.end_effector == "fr3_EE"


def test_heights_are_those_above_the_table(fr3):
    state = (0.5, 0.0, 0.0)
    assert conversions.pose_message(state).position.z == -0.05
    assert conversions.path_message(STAMP, np.array([state]), 0.3).poses[0].pose.position.z == 0.25
    assert conversions.workspace_marker(Workspace(), 0.3).pose.position.z == -0.05
    assert conversions.occupancy_grid_message(STAMP, np.ones((2, 2)), 0.4, 0.0, 0.1).info.origin.position.z == -0.05
    assert disc_marker(STAMP, "discs", 0, np.array(state), OBJECT_COLOUR).pose.position.z == pytest.approx(-0.049)
    cloud = conversions.cloud_message(STAMP, np.array([[0.5, 0.0, 0.01]]), np.ones(1))
    assert np.frombuffer(cloud.data, "<f4")[2] == pytest.approx(-0.04)
