"""The image of usb_cam: the world's table in the middle of a wider frame."""

from __future__ import annotations

import math
from typing import Tuple

import cv2
import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.simulation.scene import Scene, intrinsics
from embodied_active_learning.simulation.world import load_world

ENCODINGS = ("rgb8", "bgr8", "mono8", "yuv422", "yuv422_yuy2")
_BORDER = 96  # grey level left and right of the rendered square
# ITU-R BT.601, studio range: rows Y, U, V.
_YUV = np.array([[65.738, 129.057, 25.064], [-37.945, -74.494, 112.439], [112.439, -94.154, -18.285]]) / 256.0
_YUV_OFFSET = np.array([16.0, 128.0, 128.0])


class TableCamera:
    """Renders a world from above; the square image fills the height of the frame."""

    def __init__(self, config: Config, world: str, width: int, height: int) -> None:
        """Load the world. Raises WorldError. width, height: of the frame, px."""
        self._table_height = config.franka.table_height
        self._scene = Scene(load_world(world, config.workspace.box()), config.camera)
        self._field_of_view = config.camera.field_of_view
        self._width, self._height = width, height

    def close(self) -> None:
        """Free the renderer."""
        self._scene.close()

    def frame(self, camera: np.ndarray) -> np.ndarray:
        """Return the frame (height, width, 3) uint8 RGB for a camera pose (4, 4) in the base frame; tilt is ignored."""
        planar = np.array([camera[0, 3], camera[1, 3], math.atan2(camera[1, 0], camera[0, 0])])
        square = self._scene.render(planar, camera[2, 3] - self._table_height)
        # Repeated whole pixels: cropping and resizing restores the rendered image.
        square = cv2.resize(square, (self._height, self._height), interpolation=cv2.INTER_NEAREST)
        frame = np.full((self._height, self._width, 3), _BORDER, np.uint8)
        left = (self._width - self._height) // 2
        frame[:, left : left + self._height] = square
        return frame

    def intrinsics(self) -> np.ndarray:
        """Return the camera matrix K (3, 3) of the whole frame, px."""
        return intrinsics(self._width, self._height, self._field_of_view)


def encode(frame: np.ndarray, encoding: str) -> Tuple[bytes, int]:
    """Return data and row length [bytes] of a sensor_msgs/Image in one of ENCODINGS for RGB (H, W, 3) uint8."""
    if encoding == "rgb8":
        data = frame
    elif encoding == "bgr8":
        data = frame[..., ::-1]
    elif encoding == "mono8":
        data = cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY)
    else:
        data = _packed_yuv(frame, luma_first=encoding == "yuv422_yuy2")
    return np.ascontiguousarray(data).tobytes(), data.size // len(frame)


def _packed_yuv(frame: np.ndarray, luma_first: bool) -> np.ndarray:
    """Return (H, W, 2): Y U Y V (yuyv), or U Y V Y (yuv422 in ROS); two pixels share their chroma."""
    yuv = cv2.transform(frame, np.hstack([_YUV, _YUV_OFFSET[:, None]]))
    pairs = (yuv[:, 0::2, 1:].astype(np.uint16) + yuv[:, 1::2, 1:] + 1) // 2
    chroma = np.empty(yuv.shape[:2], np.uint8)
    chroma[:, 0::2], chroma[:, 1::2] = pairs[..., 0], pairs[..., 1]
    luma = yuv[..., 0]
    return np.stack((luma, chroma) if luma_first else (chroma, luma), axis=-1)
