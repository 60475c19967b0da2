"""The table seen from above, composed of the session's images; needs no simulator."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Tuple

import cv2
import numpy as np

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.geometry import metres_per_pixel
from embodied_active_learning.session.observations import Observations
from embodied_active_learning.session.session import Session
from embodied_active_learning.subsampling import spread_indices
from embodied_active_learning.workspace import Workspace

_MAX_SIDE = 700  # px
_MAX_VIEWS = 400
_MIN_WEIGHT = 1e-6
"""Total weight above which a pixel counts as seen."""


@dataclass(frozen=True)
class TopView:
    """An image of the table, x to the right and y upwards.

    Attributes:
        pixels: (rows, columns, 3) uint8.
        seen: (rows, columns) bool, whether any image shows the pixel.
        extent: Lowest x, highest x, lowest y, highest y [m].
    """

    pixels: np.ndarray
    seen: np.ndarray
    extent: Tuple[float, float, float, float]


@dataclass(frozen=True)
class SessionImages:
    """The observations of a session and the top view composed of them."""

    observations: Observations
    table: TopView


def load_session_images(session: Session) -> SessionImages:
    """Load a session's observations and compose the top view; a second or two for thousands of images."""
    with session.open_observations() as store:
        observations = store.snapshot()
    config = session.config
    table = compose_top_view(observations.images, observations.raw_states, config.camera, config.workspace.box())
    return SessionImages(observations, table)


def compose_top_view(images: np.ndarray, states: np.ndarray, camera: CameraConfig, workspace: Workspace) -> TopView:
    """Average images at their positions on the table.

    Args:
        images: (N, H, W, 3) uint8.
        states: (N, 3) camera states [m, m, rad].
        camera: Camera of the images.
        workspace: The view covers the workspace and half an image around it.
    """
    pixel = metres_per_pixel(camera)
    border = pixel * max(camera.width, camera.height) / 2.0
    lower, upper = np.asarray(workspace.lower[:2]) - border, np.asarray(workspace.upper[:2]) + border
    grid = max(pixel, float((upper - lower).max()) / _MAX_SIDE)
    columns, rows = (int(size) for size in np.ceil((upper - lower) / grid))
    corner = np.array([lower[0], upper[1]])
    total: np.ndarray = np.zeros((rows, columns, 4), np.float32)
    weights = _pixel_weights(camera)
    for index in spread_indices(len(images), _MAX_VIEWS):
        placement = _placement(states[index], camera, corner, grid)
        left, top, right, bottom = _footprint(placement, camera, columns, rows)
        placement[:, 2] -= (left, top)
        layered = np.dstack((images[index] * weights, weights))
        total[top:bottom, left:right] += cv2.warpAffine(layered, placement, (right - left, bottom - top))
    seen = total[..., 3] > _MIN_WEIGHT
    pixels: np.ndarray = np.zeros((rows, columns, 3), np.uint8)
    pixels[seen] = np.clip(total[seen, :3] / total[seen, 3:] + 0.5, 0, 255).astype(np.uint8)
    x, y = float(corner[0]), float(corner[1])
    return TopView(pixels, seen, (x, x + columns * grid, y - rows * grid, y))


def _placement(state: np.ndarray, camera: CameraConfig, corner: np.ndarray, grid: float) -> np.ndarray:
    """Affine map (2, 3) from image pixels (u right, v down) to pixels of the top view.

    The optical frame is Rz(theta) Rx(pi): image right is x rotated by theta, image down is -y rotated by theta.
    """
    pixel = metres_per_pixel(camera)
    cosine, sine = math.cos(state[2]), math.sin(state[2])
    rotation = pixel * np.array([[cosine, sine], [sine, -cosine]])
    centre = np.array([camera.width - 1, camera.height - 1]) / 2.0
    flip = np.array([[1.0, 0.0], [0.0, -1.0]]) / grid  # rows count downwards
    offset = flip @ (state[:2] - rotation @ centre - corner) - 0.5
    return np.column_stack((flip @ rotation, offset))


def _footprint(placement: np.ndarray, camera: CameraConfig, columns: int, rows: int) -> Tuple[int, int, int, int]:
    """Window of the top view that an image can cover: left, top, right, bottom (exclusive); at least one pixel."""
    outline = np.array([[0, camera.width - 1, 0, camera.width - 1], [0, 0, camera.height - 1, camera.height - 1]])
    corners = placement[:, :2] @ outline + placement[:, 2:]
    # Interpolation extends the image by one pixel.
    left, top = np.clip(np.floor(corners.min(axis=1)) - 1, 0, (columns - 1, rows - 1)).astype(int)
    right, bottom = np.clip(np.ceil(corners.max(axis=1)) + 2, (left + 1, top + 1), (columns, rows)).astype(int)
    return int(left), int(top), int(right), int(bottom)


def _pixel_weights(camera: CameraConfig) -> np.ndarray:
    """Weight (H, W, 1) of each pixel: largest in the middle, where tall objects are seen from above."""
    v, u = (1.0 - np.abs(np.linspace(-1.0, 1.0, size + 2)[1:-1]) for size in (camera.height, camera.width))
    return (np.minimum.outer(v, u) ** 3 + 1e-3).astype(np.float32)[..., None]
