"""Rectify camera pictures: remove lens distortion, and re-project to the pinhole camera the settings describe."""

from __future__ import annotations

from typing import Callable, Dict, Tuple

import cv2
import numpy as np
from sensor_msgs.msg import CameraInfo

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.geometry import intrinsics, metres_per_pixel
from embodied_active_learning.images import Framing

_ACCURACY = 0.01  # degrees, of the covered field of view


class LensModel:
    """Projection of a calibrated camera: camera matrix and distortion, as in sensor_msgs/CameraInfo."""

    def __init__(self, info: CameraInfo) -> None:
        """Read a calibration. Raises ValueError for an unknown distortion model."""
        self.matrix: np.ndarray = np.array(info.K, dtype=np.float64).reshape(3, 3)
        self.size: Tuple[int, int] = (info.height, info.width)
        self._coefficients: np.ndarray = np.array(info.D, dtype=np.float64)
        self._project = _projection(info.distortion_model, self._coefficients)

    def project(self, rays: np.ndarray) -> np.ndarray:
        """Pixels (N, 2) at which the camera sees directions (N, 2): x / z and y / z in the optical frame."""
        points = np.concatenate([rays, np.ones((len(rays), 1))], axis=1)[:, None]
        zero = np.zeros(3)
        pixels, _ = self._project(points, zero, zero, self.matrix, self._coefficients)
        return pixels.reshape(-1, 2)

    def covers(self, rays: np.ndarray) -> bool:
        """Return whether the picture shows all directions (N, 2)."""
        limit = np.array(self.size[::-1]) - 0.5
        pixels = self.project(rays)
        return bool(np.all((pixels >= -0.5) & (pixels <= limit)))


class Rectification:
    """Resamples pictures of a calibrated camera to images of the configured pinhole camera."""

    def __init__(self, lens: LensModel, framing: Framing, camera: CameraConfig) -> None:
        """Precompute the pixel maps."""
        height, width = framing.size
        # Sampled at about the picture's resolution first, then averaged, to avoid aliasing.
        factor = max(1, min(framing.part[0] // height, framing.part[1] // width))
        self._size = (width, height)
        self._shape = (factor * height, factor * width)
        pixels = lens.project(pixel_rays(factor * width, factor * height, camera.field_of_view))
        self._columns, self._rows = np.moveaxis(pixels.reshape(*self._shape, 2), -1, 0).astype(np.float32)

    def apply(self, picture: np.ndarray) -> np.ndarray:
        """Picture (H, W, 3) uint8 -> image (h, w, 3) uint8."""
        image = cv2.remap(picture, self._columns, self._rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        if image.shape[:2] == self._size[::-1]:
            return image
        return cv2.resize(image, self._size, interpolation=cv2.INTER_AREA)


def pixel_rays(width: int, height: int, field_of_view: float) -> np.ndarray:
    """Directions (height * width, 2) of the pixels of a pinhole camera, row by row."""
    matrix = intrinsics(width, height, field_of_view)
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    return np.stack([(columns - matrix[0, 2]) / matrix[0, 0], (rows - matrix[1, 2]) / matrix[1, 1]], axis=-1).reshape(
        -1, 2
    )


def table_error(lens: LensModel, framing: Framing, camera: CameraConfig) -> float:
    """Largest displacement (m) on the table if pictures are cropped and scaled, but not rectified."""
    height, width = framing.size
    columns, rows = np.meshgrid(np.linspace(0, width - 1, 9), np.linspace(0, height - 1, 9))
    pixels = np.stack([columns.ravel(), rows.ravel()], axis=1)
    matrix = intrinsics(width, height, camera.field_of_view)
    rays = (pixels - matrix[:2, 2]) / matrix[[0, 1], [0, 1]]
    seen = lens.project(rays) @ framing.matrix()[:2, :2].T + framing.matrix()[:2, 2]
    return float(np.hypot(*(seen - pixels).T).max() * metres_per_pixel(camera))


def covered_field_of_view(lens: LensModel, framing: Framing, largest: float) -> float:
    """Largest vertical field of view (degrees), up to a limit, that pictures cover after rectification."""
    height, width = framing.size

    def covered(degrees: float) -> bool:
        rays = pixel_rays(width, height, degrees).reshape(height, width, 2)
        return lens.covers(np.concatenate([rays[0], rays[-1], rays[:, 0], rays[:, -1]]))

    if covered(largest):
        return largest
    low, high = 0.0, largest
    while high - low > _ACCURACY:
        middle = (low + high) / 2.0
        low, high = (middle, high) if covered(middle) else (low, middle)
    return low


def _projection(model: str, coefficients: np.ndarray) -> Callable:
    """OpenCV's projection function for a distortion model of sensor_msgs."""
    if not np.all(np.isfinite(coefficients)):
        raise ValueError("its distortion coefficients are not finite")
    if not np.any(coefficients):
        return cv2.projectPoints
    known: Dict[str, Tuple[Callable, Tuple[int, ...]]] = {
        "plumb_bob": (cv2.projectPoints, (4, 5)),
        "rational_polynomial": (cv2.projectPoints, (8, 12, 14)),
        "equidistant": (_project_fisheye, (4,)),
        "fisheye": (_project_fisheye, (4,)),
    }
    if model not in known:
        raise ValueError(f"distortion model {model[:40]!r} is not supported ({', '.join(known)})")
    function, counts = known[model]
    if len(coefficients) not in counts:
        raise ValueError(f"{model} has {len(coefficients)} coefficients, expected {' or '.join(map(str, counts))}")
    return function


def _project_fisheye(
    points: np.ndarray, rotation: np.ndarray, translation: np.ndarray, matrix: np.ndarray, coefficients: np.ndarray
) -> Tuple[np.ndarray, np.ndarray]:
    return cv2.fisheye.projectPoints(points, rotation, translation, matrix, coefficients)
