"""Calibration of the camera: camera_info of the model's images, rectification, and warnings about wrong geometry."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Tuple

import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.geometry import field_of_view, intrinsics, metres_per_pixel
from embodied_active_learning.images import Framing
from embodied_active_learning.ros import names
from embodied_active_learning.ros.camera.rectification import (
    LensModel,
    Rectification,
    covered_field_of_view,
    table_error,
)
from embodied_active_learning.ros.conversions import camera_info_message

FIELD_TOLERANCE = 0.03
"""Relative difference between calibrated and configured field of view above which a warning is logged."""
_NEGLIGIBLE = 0.5  # pixels of the model's image: below this, images are not rectified


@dataclass(frozen=True)
class ImageCalibration:
    """What the calibration of a camera means for the model's images."""

    source: str
    """Where the camera matrix comes from."""
    info: CameraInfo
    """camera_info of the model's images, without a stamp."""
    rectification: Optional[Rectification] = None
    warning: str = ""
    """Why positions on the table are wrong, with numbers; empty if they are right."""


def image_calibration(info: Optional[CameraInfo], framing: Framing, camera: CameraConfig) -> ImageCalibration:
    """Derive camera_info and rectification of the model's images from the driver's camera_info.

    Positions on the table are computed from camera/field_of_view, for a pinhole camera with square pixels and centred
    optical axis. Pictures of a calibrated camera that differs are rectified to it. If that is impossible, the warning
    has the reason and the error on the table.
    """
    topic = rospy.resolve_name(names.USB_CAM_INFO)
    assumed = _assumed_info(framing, camera)
    uncalibrated = f"camera/field_of_view, without a calibration on {topic} for such pictures"
    if info is None or not is_calibrated(info):
        return ImageCalibration(uncalibrated, assumed)
    if (info.height, info.width) != framing.source:
        return ImageCalibration(
            uncalibrated,
            assumed,
            warning=f"the calibration on {topic} is for {info.width} x {info.height} pixels, the camera's pictures "
            f"have {framing.source[1]} x {framing.source[0]}: calibrate the camera at that size",
        )
    try:
        lens = LensModel(info)
    except ValueError as error:
        return ImageCalibration(
            f"the calibration on {topic}",
            _framed_info(info, framing),
            warning=f"cannot use the calibration on {topic}: {error}; rectify the pictures with image_proc",
        )
    return _apply_lens(lens, info, framing, camera)


def geometry_error(info: CameraInfo, camera: CameraConfig) -> Tuple[float, str]:
    """Return the largest error (m) of positions on the table for images with this camera_info, and its properties.

    info: of the model's images. Raises ValueError for an unsupported distortion model.
    """
    framing = Framing.between((info.height, info.width), (info.height, info.width))
    return table_error(LensModel(info), framing, camera), _summary(info, framing)


def is_calibrated(info: CameraInfo) -> bool:
    """Return whether camera_info has a camera matrix; drivers without a calibration send zeros."""
    return bool(np.all(np.isfinite(info.K))) and info.K[0] > 0.0 and info.K[4] > 0.0


def error_tolerance(camera: CameraConfig) -> float:
    """Return the largest error (m) on the table without a warning: FIELD_TOLERANCE in the corner of an image."""
    return FIELD_TOLERANCE * metres_per_pixel(camera) * math.hypot(camera.width, camera.height) / 2.0


def _apply_lens(lens: LensModel, info: CameraInfo, framing: Framing, camera: CameraConfig) -> ImageCalibration:
    """Rectify if needed and possible, else warn."""
    source, summary = f"the calibration on {rospy.resolve_name(names.USB_CAM_INFO)}", _summary(info, framing)
    framed = _framed_info(info, framing)
    error = table_error(lens, framing, camera)
    if error <= _NEGLIGIBLE * metres_per_pixel(camera):
        return ImageCalibration(source, framed)
    covered = covered_field_of_view(lens, framing, camera.field_of_view)
    if covered >= camera.field_of_view:
        source = f"camera/field_of_view; pictures are rectified by {source}: {summary}"
        source += f", up to {1000 * error:.1f} mm on the table"
        return ImageCalibration(source, _assumed_info(framing, camera), Rectification(lens, framing, camera))
    if error <= error_tolerance(camera):
        return ImageCalibration(source, framed)
    warning = (
        f"positions on the table are wrong by up to {1000 * error:.1f} mm: camera/field_of_view is "
        f"{camera.field_of_view:.1f} degrees, the calibrated camera has {summary}; set camera/field_of_view to "
        f"{np.floor(10 * covered) / 10:.1f} or less, so that the pictures can be rectified"
    )
    return ImageCalibration(source, framed, warning=warning)


def _assumed_info(framing: Framing, camera: CameraConfig) -> CameraInfo:
    """camera_info of a pinhole camera with camera/field_of_view."""
    height, width = framing.size
    return camera_info_message(rospy.Time(), intrinsics(width, height, camera.field_of_view), height, width)


def _framed_info(info: CameraInfo, framing: Framing) -> CameraInfo:
    """camera_info after cropping and scaling; distortion does not depend on the size."""
    height, width = framing.size
    matrix = framing.matrix() @ np.reshape(info.K, (3, 3))
    message = camera_info_message(rospy.Time(), matrix, height, width)
    message.distortion_model, message.D, message.R = info.distortion_model, info.D, info.R
    message.P = (framing.matrix() @ np.reshape(info.P, (3, 4))).ravel().tolist()
    return message


def _summary(info: CameraInfo, framing: Framing) -> str:
    """The properties of a calibration that matter for positions, of the model's images."""
    height, width = framing.size
    matrix = framing.matrix() @ np.reshape(info.K, (3, 3))
    right, down = matrix[0, 2] - (width - 1) / 2.0, matrix[1, 2] - (height - 1) / 2.0
    distortion = info.distortion_model if np.any(info.D) else "none"
    return (
        f"field of view {field_of_view(matrix, height):.1f} degrees, optical axis {right:+.1f}, {down:+.1f} px off "
        f"centre, fx/fy {matrix[0, 0] / matrix[1, 1]:.3f}, distortion {distortion}"
    )
