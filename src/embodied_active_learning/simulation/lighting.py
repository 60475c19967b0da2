"""Effect of lighting on the camera's images: brightness, gradient, soft shadow, and white balance.

It only multiplies the rendered colours: objects cast no shadows, and their shading is that of the renderer (scene).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Tuple

import numpy as np

from embodied_active_learning.simulation.world_settings import Lighting

BLUR_SAMPLES = 5
"""Number of poses over which a moving camera's exposure is averaged."""
_DARKEST = 0.02  # gain


class LightField:
    """Multiplies an image by the light that falls on the table."""

    def __init__(self, lighting: Lighting, centre: Tuple[float, ...]) -> None:
        """centre: (x, y) of the table, m: where the gradient is neutral, and the default place of the shadow."""
        self._lighting = lighting
        self._centre = np.asarray(centre)
        self._shadow_centre = self._centre if lighting.shadow_centre is None else np.asarray(lighting.shadow_centre)
        self._active = replace(lighting, motion_blur=0.0) != Lighting()  # the scene renders the blur

    def apply(self, picture: np.ndarray, camera: np.ndarray, matrix: np.ndarray) -> np.ndarray:
        """Light a picture (H, W, 3) uint8 seen from pose (4, 4) straight above the table, with camera matrix (3, 3)."""
        if not self._active:
            return picture
        gain = self._gain(_table_points(picture.shape[:2], camera, matrix))
        lit = picture * gain[:, :, None] * np.asarray(self._lighting.white_balance)
        return np.clip(np.rint(lit), 0, 255).astype(np.uint8)

    def _gain(self, points: np.ndarray) -> np.ndarray:
        """Brightness at points (..., 2), m, of the table."""
        settings = self._lighting
        direction = np.array([np.cos(settings.gradient_direction), np.sin(settings.gradient_direction)])
        slope = 1.0 + settings.gradient * ((points - self._centre) @ direction)
        distance = np.sum((points - self._shadow_centre) ** 2, axis=-1)
        shadow = 1.0 - settings.shadow * np.exp(-distance / (2.0 * settings.shadow_radius**2))
        return settings.brightness * np.maximum(slope * shadow, _DARKEST)


def _table_points(shape: Tuple[int, ...], camera: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """(H, W, 2) points of the table, m, that the pixels show."""
    rows, columns = np.indices(shape[:2])
    x, y = (columns - matrix[0, 2]) / matrix[0, 0], (rows - matrix[1, 2]) / matrix[1, 1]
    return camera[:2, 3] + camera[2, 3] * np.stack([x, y], axis=-1) @ camera[:2, :2].T
