"""Conversion between arrays and ROS messages: states, images, camera calibration, paths, clouds, grids and markers."""

from __future__ import annotations

import math
from typing import Mapping, Sequence, Tuple, Union

import numpy as np
import rospy
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion, Transform, TransformStamped, Vector3
from nav_msgs.msg import MapMetaData, OccupancyGrid, Path
from sensor_msgs.msg import CameraInfo, Image, JointState, PointCloud2, PointField
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker

from embodied_active_learning.errors import ObservationError
from embodied_active_learning.franka.mount import CameraMount
from embodied_active_learning.geometry import quaternion, rotation_matrix
from embodied_active_learning.images import decode_raw
from embodied_active_learning.msg import PlanarState
from embodied_active_learning.ros import names
from embodied_active_learning.workspace import Workspace

Values = Union[np.ndarray, Sequence[float]]


def state_message(stamp: rospy.Time, state: Values, velocity: Values) -> PlanarState:
    """Convert a state (3,) [m, m, rad] and its velocity (3,) [m/s, m/s, rad/s] in the base frame."""
    return PlanarState(Header(stamp=stamp, frame_id=names.FRAMES.base), *map(float, state), *map(float, velocity))


def state_arrays(message: PlanarState) -> Tuple[np.ndarray, np.ndarray]:
    """Return the state (3,) [m, m, rad] and the velocity (3,) [m/s, m/s, rad/s]."""
    state = np.array([message.x, message.y, message.theta])
    return state, np.array([message.vx, message.vy, message.omega])


def states_array(values: Values, size: int = 3) -> np.ndarray:
    """Return rows (N, size) from their concatenated values.

    Raises:
        ObservationError: the values do not fill rows or are not finite.
    """
    array: np.ndarray = np.asarray(values, dtype=np.float64)
    if array.size % size:
        raise ObservationError(f"malformed states: {array.size} values do not fill rows of {size}")
    if not np.all(np.isfinite(array)):
        raise ObservationError("malformed states: not all values are finite")
    return array.reshape(-1, size)


def joint_state_message(
    stamp: rospy.Time, positions: Mapping[str, float], velocities: Mapping[str, float]
) -> JointState:
    """Convert positions [rad] and velocities [rad/s] of the same joints by name."""
    joints = list(positions)
    return JointState(
        header=Header(stamp=stamp),
        name=joints,
        position=list(positions.values()),
        velocity=[velocities[name] for name in joints],
    )


def image_message(stamp: rospy.Time, image: np.ndarray) -> Image:
    """Convert an image (H, W, 3) uint8 RGB to encoding rgb8."""
    height, width = image.shape[:2]
    header = Header(stamp=stamp, frame_id=names.CAMERA_FRAME)
    return Image(header, height, width, "rgb8", 0, 3 * width, image.tobytes())


def decode_image(message: Image) -> np.ndarray:
    """Return the image (H, W, 3) uint8 RGB of a message. Raises ObservationError if it is malformed or unsupported."""
    return decode_raw(message.data, message.encoding, message.height, message.width, message.step)


def image_array(message: Image, height: int, width: int) -> np.ndarray:
    """Return the image (height, width, 3) uint8 RGB of a message in rgb8 or bgr8.

    Raises:
        ObservationError: another size or encoding.
    """
    if message.encoding not in ("rgb8", "bgr8"):
        raise ObservationError(f"image encoding is {message.encoding!r}: the model takes rgb8 (or bgr8)")
    if (message.height, message.width) != (height, width):
        raise ObservationError(
            f"image is {message.width} x {message.height} pixels, the model takes {width} x {height}: "
            "set camera/width and camera/height, or scale the images"
        )
    return decode_image(message)


def camera_info_message(stamp: rospy.Time, intrinsics: np.ndarray, height: int, width: int) -> CameraInfo:
    """Convert the intrinsic matrix (3, 3) of an undistorted camera."""
    info = CameraInfo(header=Header(stamp=stamp, frame_id=names.CAMERA_FRAME), height=height, width=width)
    info.distortion_model = "plumb_bob"
    info.D = [0.0] * 5
    info.K = intrinsics.ravel().tolist()
    info.R = np.eye(3).ravel().tolist()
    info.P = np.hstack([intrinsics, np.zeros((3, 1))]).ravel().tolist()
    return info


def mount_message(stamp: rospy.Time, mount: CameraMount) -> TransformStamped:
    """Convert the camera mount to the transform of camera_optical_frame in the end effector frame."""
    header = Header(stamp=stamp, frame_id=names.FRAMES.end_effector)
    transform = Transform(Vector3(*mount.position), Quaternion(*quaternion(mount.rotation)))
    return TransformStamped(header, names.CAMERA_FRAME, transform)


def camera_message(stamp: rospy.Time, position: np.ndarray, rotation: np.ndarray) -> TransformStamped:
    """Return the transform of camera_optical_frame, at position (3,) [m] with rotation (3, 3), in the base frame."""
    header = Header(stamp=stamp, frame_id=names.FRAMES.base)
    transform = Transform(Vector3(*map(float, position)), Quaternion(*quaternion(rotation)))
    return TransformStamped(header, names.CAMERA_FRAME, transform)


def pose_matrix(position: Union[Point, Vector3], orientation: Quaternion) -> np.ndarray:
    """Return position [m] and orientation of a pose or transform as a matrix (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_matrix(orientation.x, orientation.y, orientation.z, orientation.w)
    matrix[:3, 3] = position.x, position.y, position.z
    return matrix


def path_message(stamp: rospy.Time, states: np.ndarray, height: float) -> Path:
    """Convert states (N, 3) [m, m, rad] to a path at a height above the table [m]."""
    header = Header(stamp=stamp, frame_id=names.FRAMES.base)
    return Path(header, [PoseStamped(header, pose_message(state, height)) for state in states])


def pose_message(state: Values, height: float = 0.0) -> Pose:
    """Return the pose in the base frame of (x [m], y [m], theta [rad]) at a height above the table [m]."""
    x, y, theta = map(float, state)
    turn = Quaternion(0.0, 0.0, math.sin(theta / 2.0), math.cos(theta / 2.0))
    return Pose(Point(x, y, names.FRAMES.table_height + height), turn)


def cloud_message(stamp: rospy.Time, points: np.ndarray, values: np.ndarray) -> PointCloud2:
    """Convert points (N, 3) [m], z above the table, with values (N,) to a cloud with an intensity channel."""
    data = np.column_stack([points + np.array([0.0, 0.0, names.FRAMES.table_height]), values]).astype("<f4")
    fields = [PointField(n, 4 * i, PointField.FLOAT32, 1) for i, n in enumerate(("x", "y", "z", "intensity"))]
    header = Header(stamp=stamp, frame_id=names.FRAMES.base)
    return PointCloud2(header, 1, len(data), fields, False, 16, 16 * len(data), data.tobytes(), True)


def occupancy_grid_message(stamp: rospy.Time, values: np.ndarray, x0: float, y0: float, cell: float) -> OccupancyGrid:
    """Convert values between 0 and 1 of square cells on the table to a grid of 0 to 100.

    Args:
        stamp: time of the message.
        values: (nx, ny), clipped to [0, 1].
        x0: x of the centre of the first cell [m].
        y0: y of the centre of the first cell [m].
        cell: side of a cell [m].
    """
    width, height = values.shape
    corner = pose_message((x0 - cell / 2.0, y0 - cell / 2.0, 0.0), 0.0)
    percent = np.rint(100.0 * np.clip(values, 0.0, 1.0)).astype(np.int8)
    header = Header(stamp=stamp, frame_id=names.FRAMES.base)
    return OccupancyGrid(header, MapMetaData(stamp, cell, width, height, corner), percent.T.ravel().tolist())


def workspace_marker(workspace: Workspace, height: float) -> Marker:
    """Return the workspace of the camera as the edges of a box from the table up to the camera's height [m]."""
    (x0, y0), (x1, y1) = workspace.lower[:2], workspace.upper[:2]
    corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    marker = Marker(type=Marker.LINE_LIST, action=Marker.ADD, ns="workspace")
    marker.header.frame_id = names.FRAMES.base
    marker.pose.position.z = names.FRAMES.table_height
    marker.pose.orientation.w = 1.0
    marker.scale.x = 0.002
    marker.color = ColorRGBA(0.1, 0.1, 0.1, 0.9)
    for (xa, ya), (xb, yb) in zip(corners, corners[1:] + corners[:1]):
        for z in (0.0, height):
            marker.points += [Point(xa, ya, z), Point(xb, yb, z)]
        marker.points += [Point(xa, ya, 0.0), Point(xa, ya, height)]
    return marker
