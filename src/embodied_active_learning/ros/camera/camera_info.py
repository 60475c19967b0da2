"""The camera matrix of the model's images: from the calibration of the camera that took them, or from the settings."""

from __future__ import annotations

from typing import Optional

import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.geometry import FIELD_TOLERANCE, field_of_view, intrinsics
from embodied_active_learning.images import Framing
from embodied_active_learning.ros import names
from embodied_active_learning.ros.conversions import camera_info_message


def is_calibrated(info: Optional[CameraInfo]) -> bool:
    """Whether a driver tells more than the size of its pictures; without a calibration it sends zeros."""
    return info is not None and bool(np.all(np.isfinite(info.K))) and info.K[0] > 0.0 and info.K[4] > 0.0


def is_usable(info: Optional[CameraInfo], framing: Framing) -> bool:
    """Whether there is a calibration, and of pictures of this size."""
    return is_calibrated(info) and (info.height, info.width) == framing.source


def model_camera_info(
    stamp: rospy.Time, info: Optional[CameraInfo], framing: Framing, camera: CameraConfig
) -> CameraInfo:
    """CameraInfo of the model's images: from that of the camera's pictures, or from camera/field_of_view.

    Distortion is passed on, as it does not depend on the size: the images are not rectified.
    """
    height, width = framing.size
    message = camera_info_message(stamp, intrinsics(width, height, camera.field_of_view), height, width)
    if not is_usable(info, framing):
        return message
    message.distortion_model, message.D, message.R = info.distortion_model, info.D, info.R
    message.K = (framing.matrix() @ np.reshape(info.K, (3, 3))).ravel().tolist()
    message.P = (framing.matrix() @ np.reshape(info.P, (3, 4))).ravel().tolist()
    return message


def calibration_complaint(info: Optional[CameraInfo], framing: Framing, camera: CameraConfig) -> str:
    """What there is to say when the calibration does not fit the pictures, or the settings do not fit it; else nothing.

    What is where on the table is computed from camera/field_of_view.
    """
    if not is_calibrated(info):
        return ""
    if not is_usable(info, framing):
        return (
            f"the calibration on {rospy.resolve_name(names.USB_CAM_INFO)} is of {info.width} x {info.height} pixels, "
            f"the camera's images have {framing.source[1]} x {framing.source[0]}: calibrate it at that size"
        )
    measured = field_of_view(framing.matrix() @ np.reshape(info.K, (3, 3)), camera.height)
    if abs(measured - camera.field_of_view) > FIELD_TOLERANCE * camera.field_of_view:
        return (
            f"the calibrated field of view of the images is {measured:.1f} degrees, camera/field_of_view is "
            f"{camera.field_of_view:.1f}: set it to that, or objects are taken to be where they are not"
        )
    return ""
