"""Checks of the camera images and of the camera matrix."""

from __future__ import annotations

from typing import List, Sequence

import cv2
import numpy as np
from sensor_msgs.msg import CameraInfo

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.ros.camera.camera_info import error_tolerance, geometry_error, is_calibrated
from embodied_active_learning.ros.preflight.check_result import CheckResult, error, ok, warning

DARK, BRIGHT = 8, 250
"""Grey levels at which a pixel counts as black or saturated."""
MAX_CLIPPED = 0.1
"""Largest acceptable fraction of black pixels, and of saturated ones."""
MIN_SHARPNESS = 3.0
"""Variance of the Laplacian [grey levels^2] below which an image is out of focus or shows nothing."""
FROZEN_COUNT = 3
"""Number of identical images in a row that no working camera takes."""

_REASON = "the model learns from these images"


def check_content(images: Sequence[np.ndarray], camera: CameraConfig, real: bool) -> List[CheckResult]:
    """Check images for content, exposure, sharpness and a frozen camera.

    Args:
        images: (N, H, W, 3) uint8, newest last.
        camera: the camera's configuration.
        real: whether they come from a real camera, whose noise makes all images different.
    """
    newest = images[-1]
    if np.all(newest == newest[0, 0]) and not camera.allow_featureless:
        return [
            error(
                "image content",
                f"all pixels have the colour {newest[0, 0].tolist()}",
                "the planner stops the arm on such images",
                "uncover the lens, switch on the light; look at the image in rviz or rqt_image_view",
            )
        ]
    results = [_check_exposure(newest), _check_sharpness(newest)]
    if real and len(images) >= FROZEN_COUNT and all(np.array_equal(image, newest) for image in images[-FROZEN_COUNT:]):
        results.append(
            warning(
                "image content",
                f"the last {FROZEN_COUNT} images are identical",
                "images of a real camera differ by noise: the camera or its driver is frozen",
                "restart the camera driver; try another USB port",
            )
        )
    return results


def check_camera_matrix(info: CameraInfo, camera: CameraConfig) -> CheckResult:
    """Check size, camera matrix and distortion of the images' CameraInfo."""
    name, reason = "camera matrix", "positions of objects are computed from camera/field_of_view"
    if (info.height, info.width) != (camera.height, camera.width) or not is_calibrated(info):
        return error(
            name,
            f"CameraInfo of {info.width} x {info.height} pixels with K {list(info.K)[:6]}; images have "
            f"{camera.width} x {camera.height}",
            reason,
            "see the log of camera_pipeline, which publishes it",
        )
    try:
        distance, summary = geometry_error(info, camera)
    except ValueError as problem:
        return warning(name, str(problem), reason, "rectify the images with image_proc")
    message = f"{summary}; camera/field_of_view {camera.field_of_view:.1f}"
    if not distance <= error_tolerance(camera):
        remedy = "see the log of camera_pipeline: set camera/field_of_view, or calibrate the camera"
        return warning(name, f"{message}: up to {1000 * distance:.1f} mm wrong on the table", reason, remedy)
    return ok(name, message)


def _check_exposure(image: np.ndarray) -> CheckResult:
    dark, bright = float(np.mean(image.max(axis=-1) <= DARK)), float(np.mean(image.max(axis=-1) >= BRIGHT))
    message = f"mean {image.mean():.0f} of 255, {dark:.0%} of the pixels black, {bright:.0%} saturated"
    if bright > MAX_CLIPPED:
        return warning("exposure", message, _REASON, "lower the exposure of the camera, or dim the light")
    if dark > MAX_CLIPPED:
        return warning("exposure", message, _REASON, "raise the exposure of the camera, or add light")
    return ok("exposure", message)


def _check_sharpness(image: np.ndarray) -> CheckResult:
    sharpness = float(cv2.Laplacian(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), cv2.CV_64F).var())
    message = f"variance of the Laplacian {sharpness:.1f}"
    if sharpness < MIN_SHARPNESS:
        return warning("sharpness", message, "blurred details cannot be learned", "focus with an object in view")
    return ok("sharpness", message)
