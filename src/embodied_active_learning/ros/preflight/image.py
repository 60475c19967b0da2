"""Checks of what the camera sees."""

from __future__ import annotations

from typing import List, Sequence

import cv2
import numpy as np

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.geometry import FIELD_TOLERANCE, field_of_view
from embodied_active_learning.ros.preflight.check_result import CheckResult, fine, missing, warning

DARK, BRIGHT = 8, 250
"""Grey levels at and below, at and above which a pixel tells nothing."""
MOST_LOST = 0.1
"""Part of the pixels that may be dark, or bright."""
LEAST_SHARP = 3.0
"""Variance of the Laplacian, grey levels squared, below which a picture is out of focus, or of nothing."""
SEVERAL = 3
"""Pictures that a camera which works never takes twice alike."""

_LEARN = "the model learns from these images, whatever they show"


def check_picture(images: Sequence[np.ndarray], camera: CameraConfig, live: bool) -> List[CheckResult]:
    """Images (N, H, W, 3) uint8, the newest last; live: of a real camera, whose noise makes each another one."""
    newest = images[-1]
    if np.all(newest == newest[0, 0]) and not camera.allow_featureless:
        return [
            missing(
                "picture",
                f"it is of one single colour, {newest[0, 0].tolist()}",
                "the arm is held still for such images",
                "uncover the lens, switch on the light; look at the image in rviz or rqt_image_view",
            )
        ]
    findings = [_exposure(newest), _sharpness(newest)]
    if live and len(images) >= SEVERAL and all(np.array_equal(image, newest) for image in images[-SEVERAL:]):
        findings.append(
            warning(
                "picture",
                f"the last {SEVERAL} images are the same to the last bit",
                "a real camera has noise: it, or its driver, is frozen",
                "wave a hand before it and look again; start the camera's driver again; another USB socket",
            )
        )
    return findings


def check_camera_matrix(matrix: Sequence[float], height: int, width: int, camera: CameraConfig) -> CheckResult:
    """K (9,) of images of a height and width, against the settings."""
    about, why = "camera matrix", "where an object is found depends on camera/field_of_view"
    if (height, width) != (camera.height, camera.width) or not (np.all(np.isfinite(matrix)) and matrix[4] > 0.0):
        return missing(
            about,
            f"camera_info is of {width} x {height} pixels, with K {list(matrix)[:6]}",
            why,
            "see to camera_pipeline, which makes it of the camera's own",
        )
    measured = field_of_view(np.reshape(matrix, (3, 3)), height)
    found = f"field of view {measured:.1f} degrees, camera/field_of_view {camera.field_of_view:.1f}"
    if abs(measured - camera.field_of_view) > FIELD_TOLERANCE * camera.field_of_view:
        return warning(about, found, why, f"set camera/field_of_view to {measured:.1f}, or calibrate the camera again")
    return fine(about, found)


def _exposure(image: np.ndarray) -> CheckResult:
    dark, bright = float(np.mean(image.max(axis=-1) <= DARK)), float(np.mean(image.max(axis=-1) >= BRIGHT))
    found = f"mean {image.mean():.0f} of 255, {dark:.0%} of the pixels black, {bright:.0%} saturated"
    if bright > MOST_LOST:
        return warning("exposure", found, _LEARN, "lower the camera's exposure, or dim the light")
    if dark > MOST_LOST:
        return warning("exposure", found, _LEARN, "raise the camera's exposure, or give more light")
    return fine("exposure", found)


def _sharpness(image: np.ndarray) -> CheckResult:
    sharpness = float(cv2.Laplacian(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), cv2.CV_64F).var())
    found = f"variance of the Laplacian {sharpness:.1f}"
    if sharpness < LEAST_SHARP:
        return warning(
            "sharpness",
            found,
            "details smaller than the blur cannot be learned",
            "set the focus with an object in view",
        )
    return fine("sharpness", found)
