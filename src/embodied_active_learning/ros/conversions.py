"""Messages to arrays and back: the one place that knows how messages lay out states, images, clouds and paths."""

from __future__ import annotations

import math
from typing import Mapping, Sequence, Tuple

import numpy as np
import rospy
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion, Transform, TransformStamped, Vector3
from nav_msgs.msg import MapMetaData, OccupancyGrid, Path
from sensor_msgs.msg import CameraInfo, Image, JointState, PointCloud2, PointField
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker

from embodied_active_learning.errors import ObservationError
from embodied_active_learning.franka.mount import CameraMount, quaternion
from embodied_active_learning.images import decode_raw
from embodied_active_learning.msg import PlanarState
from embodied_active_learning.ros import names
from embodied_active_learning.workspace import Workspace


def state_message(stamp: rospy.Time, state: Sequence[float], velocity: Sequence[float]) -> PlanarState:
    """State (3,) [m, m, rad] and velocity (3,) [m/s, m/s, rad/s] -> PlanarState in the base frame."""
    return PlanarState(Header(stamp=stamp, frame_id=names.BASE_FRAME), *map(float, state), *map(float, velocity))


def state_arrays(message: PlanarState) -> Tuple[np.ndarray, np.ndarray]:
    """PlanarState -> state (3,) [m, m, rad], velocity (3,) [m/s, m/s, rad/s]."""
    state = np.array([message.x, message.y, message.theta])
    return state, np.array([message.vx, message.vy, message.omega])


def joint_state_message(
    stamp: rospy.Time, positions: Mapping[str, float], velocities: Mapping[str, float]
) -> JointState:
    """Positions [rad] and velocities [rad/s] of the same joints by name -> sensor_msgs/JointState."""
    joints = list(positions)
    return JointState(
        header=Header(stamp=stamp),
        name=joints,
        position=list(positions.values()),
        velocity=[velocities[name] for name in joints],
    )


def image_message(stamp: rospy.Time, image: np.ndarray) -> Image:
    """Image (H, W, 3) uint8 RGB -> sensor_msgs/Image."""
    height, width, _ = image.shape
    header = Header(stamp=stamp, frame_id=names.CAMERA_FRAME)
    return Image(header, height, width, "rgb8", 0, 3 * width, image.tobytes())


def image_array(message: Image, height: int, width: int) -> np.ndarray:
    """sensor_msgs/Image -> (height, width, 3) uint8 RGB. Raises ObservationError for another size or encoding."""
    if message.encoding not in ("rgb8", "bgr8"):
        raise ObservationError(f"image encoding is {message.encoding!r}: the model takes rgb8 (or bgr8)")
    if (message.height, message.width) != (height, width):
        raise ObservationError(
            f"image is {message.width} x {message.height} pixels, the model takes {width} x {height}: "
            "set camera/width and camera/height, or scale the image before it gets here"
        )
    return decode_raw(message.data, message.encoding, height, width, message.step)


def camera_info_message(stamp: rospy.Time, intrinsics: np.ndarray, height: int, width: int) -> CameraInfo:
    """Intrinsic matrix (3, 3) of an undistorted camera -> sensor_msgs/CameraInfo."""
    info = CameraInfo(header=Header(stamp=stamp, frame_id=names.CAMERA_FRAME), height=height, width=width)
    info.distortion_model = "plumb_bob"
    info.D = [0.0] * 5
    info.K = intrinsics.ravel().tolist()
    info.R = np.eye(3).ravel().tolist()
    info.P = np.hstack([intrinsics, np.zeros((3, 1))]).ravel().tolist()
    return info


def mount_message(stamp: rospy.Time, mount: CameraMount) -> TransformStamped:
    """Where the camera is fixed to the end effector -> the transform of camera_optical_frame in panda_EE."""
    header = Header(stamp=stamp, frame_id=names.END_EFFECTOR_FRAME)
    transform = Transform(Vector3(*mount.position), Quaternion(*quaternion(mount.rotation)))
    return TransformStamped(header, names.CAMERA_FRAME, transform)


def states_array(values: Sequence[float], size: int = 3) -> np.ndarray:
    """Row-by-row values -> (N, size). Raises ObservationError when they do not fill rows or are not finite."""
    array = np.asarray(values, dtype=np.float64)
    if array.size % size:
        raise ObservationError(f"{array.size} values do not fill rows of {size}")
    if not np.all(np.isfinite(array)):
        raise ObservationError("the states hold values that are not finite")
    return array.reshape(-1, size)


def path_message(stamp: rospy.Time, states: np.ndarray, height: float) -> Path:
    """States (N, 3) in SI units, drawn at a height above the table [m] -> nav_msgs/Path."""
    header = Header(stamp=stamp, frame_id=names.BASE_FRAME)
    return Path(header, [PoseStamped(header, _pose(state, height)) for state in states])


def _pose(state: Sequence[float], height: float) -> Pose:
    x, y, theta = map(float, state)
    return Pose(Point(x, y, height), Quaternion(0.0, 0.0, math.sin(theta / 2.0), math.cos(theta / 2.0)))


def cloud_message(stamp: rospy.Time, points: np.ndarray, values: np.ndarray) -> PointCloud2:
    """Points (N, 3) [m] and values (N,) -> sensor_msgs/PointCloud2 with an intensity channel."""
    data = np.column_stack([points, values]).astype("<f4")
    fields = [PointField(n, 4 * i, PointField.FLOAT32, 1) for i, n in enumerate(("x", "y", "z", "intensity"))]
    header = Header(stamp=stamp, frame_id=names.BASE_FRAME)
    return PointCloud2(header, 1, len(data), fields, False, 16, 16 * len(data), data.tobytes(), True)


def occupancy_grid_message(stamp: rospy.Time, values: np.ndarray, x0: float, y0: float, cell: float) -> OccupancyGrid:
    """Values (nx, ny), 0 .. 1, of square cells -> nav_msgs/OccupancyGrid with 0 .. 100 on the table.

    (x0, y0) is the middle of the first cell, and cell the length of a side [m].
    """
    width, height = values.shape
    corner = _pose((x0 - cell / 2.0, y0 - cell / 2.0, 0.0), 0.0)
    percent = np.rint(100.0 * np.clip(values, 0.0, 1.0)).astype(np.int8)
    header = Header(stamp=stamp, frame_id=names.BASE_FRAME)
    return OccupancyGrid(header, MapMetaData(stamp, cell, width, height, corner), percent.T.ravel().tolist())


def workspace_marker(workspace: Workspace, height: float) -> Marker:
    """The box that the camera may move in, as lines from the table up to the camera's height [m]."""
    (x0, y0), (x1, y1) = workspace.lower[:2], workspace.upper[:2]
    corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    marker = Marker(type=Marker.LINE_LIST, action=Marker.ADD, ns="workspace")
    marker.header.frame_id = names.BASE_FRAME
    marker.pose.orientation.w = 1.0
    marker.scale.x = 0.002
    marker.color = ColorRGBA(0.1, 0.1, 0.1, 0.9)
    for (xa, ya), (xb, yb) in zip(corners, corners[1:] + corners[:1]):
        for z in (0.0, height):
            marker.points += [Point(xa, ya, z), Point(xb, yb, z)]
        marker.points += [Point(xa, ya, 0.0), Point(xa, ya, height)]
    return marker
