"""Camera latency: the time from the exposure of an image to its stamp, from images and poses of a rotating camera."""

from __future__ import annotations

import math
from typing import NamedTuple, Sequence

import cv2
import numpy as np

from embodied_active_learning.errors import ObservationError

MAX_LATENCY = 0.5
"""Largest latency that is searched for, s."""
MIN_IMAGES = 20
"""Fewer images do not determine the latency."""
MIN_TURN = 0.2
"""Smallest range of yaw that determines the latency, rad."""
MAX_RESIDUAL = 0.02
"""Largest standard deviation of the yaw seen in the images from the measured yaw, rad."""
_STEP = 0.005  # s of the search, before refinement
_ANGLES, _RADII = 720, 90  # size of polar images


class LatencyEstimate(NamedTuple):
    """Latency [s], its standard error [s], and the residual of the yaw [rad]."""

    latency: float
    std_error: float
    residual: float


class RotationTracker:
    """Measures the rotation of images about their middle, relative to the first one."""

    def __init__(self) -> None:
        self._reference: np.ndarray = np.empty(0)

    def rotation(self, image: np.ndarray) -> float:
        """Return the rotation [rad] of an image (H, W) or (H, W, 3) from the first one, within -pi to pi."""
        spectrum = np.fft.rfft(_polar(image), axis=0)
        if not self._reference.size:
            self._reference = spectrum
        # Rotation is a circular shift along the angle: take the peak of the correlation, summed over all radii.
        correlation = np.fft.irfft((spectrum * self._reference.conj()).sum(axis=1), _ANGLES)
        peak = int(correlation.argmax())
        left, middle, right = (float(correlation[(peak + offset) % _ANGLES]) for offset in (-1, 0, 1))
        curvature = left - 2.0 * middle + right
        shift = peak + (0.5 * (left - right) / curvature if curvature < 0.0 else 0.0)
        return math.remainder(shift * 2.0 * math.pi / _ANGLES, 2.0 * math.pi)


def estimate_latency(
    image_stamps: Sequence[float], rotations: Sequence[float], pose_stamps: Sequence[float], yaws: Sequence[float]
) -> LatencyEstimate:
    """Return the latency that best aligns the rotation of the images with the measured yaw.

    The motion has to change its direction: at a constant rate, latency and offset have the same effect.

    Args:
        image_stamps: (N,) s, ascending.
        rotations: (N,) rad, of the images, in either sense.
        pose_stamps: (M,) s, ascending.
        yaws: (M,) rad, of the camera.

    Raises:
        ObservationError: The data do not determine the latency.
    """
    stamps: np.ndarray = np.asarray(image_stamps, dtype=np.float64)
    times: np.ndarray = np.asarray(pose_stamps, dtype=np.float64)
    seen, measured = np.unwrap(np.asarray(rotations, dtype=float)), np.unwrap(np.asarray(yaws, dtype=float))
    usable = (stamps >= times[0] + MAX_LATENCY) & (stamps <= times[-1]) if len(times) else np.zeros(len(stamps), bool)
    stamps, seen = stamps[usable], seen[usable]
    if len(stamps) < MIN_IMAGES:
        raise ObservationError(f"only {len(stamps)} images between the poses: check camera and arm state topics")
    if np.ptp(np.interp(stamps, times, measured)) < MIN_TURN:
        raise ObservationError(f"the camera turned by less than {MIN_TURN} rad: the latency is not determined")

    def residuals(latency: float) -> np.ndarray:
        yaw = np.interp(stamps - latency, times, measured)
        centred, reference = yaw - yaw.mean(), seen - seen.mean()
        sense = 1.0 if centred @ reference >= 0.0 else -1.0
        return np.asarray(sense * reference - centred)

    latencies = np.arange(-_STEP, MAX_LATENCY, _STEP)
    costs = np.array([np.mean(residuals(latency) ** 2) for latency in latencies])
    best = int(np.argmin(costs))
    if best in (0, len(costs) - 1):
        raise ObservationError(f"no latency between 0 and {MAX_LATENCY} s fits: check the stamps of images and states")
    left, middle, right = costs[best - 1 : best + 2]
    curvature = left - 2.0 * middle + right
    latency = float(latencies[best] + 0.5 * _STEP * (left - right) / curvature)
    residual = math.sqrt(max(float(np.mean(residuals(latency) ** 2)), 0.0))
    if residual > MAX_RESIDUAL:
        raise ObservationError(
            f"the rotation of the images deviates from the measured yaw by {residual:.3f} rad: give the camera a view "
            "with texture, and check that the camera's mount is configured"
        )
    # The cost is residual variance plus mean squared yaw rate times squared latency error.
    squared_rate = 0.5 * float(curvature) / _STEP**2
    return LatencyEstimate(latency, residual / math.sqrt(squared_rate * len(stamps)), residual)


def _polar(image: np.ndarray) -> np.ndarray:
    """Return an image about its middle in polar coordinates: (_ANGLES, _RADII) float32 with zero mean."""
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    height, width = grey.shape
    radius = (min(height, width) - 1) / 2.0
    centre = ((width - 1) / 2.0, (height - 1) / 2.0)
    polar = cv2.warpPolar(grey.astype(np.float32), (_RADII, _ANGLES), centre, radius, cv2.INTER_LINEAR)
    return np.asarray(polar - polar.mean())
