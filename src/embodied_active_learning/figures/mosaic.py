"""The table from above, put together from what the camera saw: needs no simulator, so it works on hardware too."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Tuple

import cv2
import numpy as np

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.figures.style import spread
from embodied_active_learning.geometry import metres_per_pixel
from embodied_active_learning.session.observations import Observations
from embodied_active_learning.session.session import Session
from embodied_active_learning.workspace import Workspace

_LARGEST = 700  # px along the longer side
_MOST_VIEWS = 400


@dataclass(frozen=True)
class TopView:
    """A picture of the table, x to the right and y upwards."""

    pixels: np.ndarray  # (rows, columns, 3) uint8
    seen: np.ndarray  # (rows, columns) bool
    extent: Tuple[float, float, float, float]  # m: lowest x, highest x, lowest y, highest y


@dataclass(frozen=True)
class Seen:
    """What the camera saw in a session, and the table from above, put together from it."""

    observations: Observations
    table: TopView


def look_back(session: Session) -> Seen:
    """What a session's camera has seen up to now. With thousands of images it takes a second or two."""
    with session.open_observations() as store:
        seen = store.snapshot()
    config = session.config
    return Seen(seen, top_view(seen.images, seen.raw_states, config.camera, config.workspace.box()))


def top_view(images: np.ndarray, states: np.ndarray, camera: CameraConfig, workspace: Workspace) -> TopView:
    """The average of images (N, H, W, 3) uint8, each laid where the camera saw it from its state (N, 3) [m, m, rad]."""
    pixel = metres_per_pixel(camera)
    border = pixel * max(camera.width, camera.height) / 2.0
    lower, upper = np.asarray(workspace.lower[:2]) - border, np.asarray(workspace.upper[:2]) + border
    grid = max(pixel, float((upper - lower).max()) / _LARGEST)
    columns, rows = np.ceil((upper - lower) / grid).astype(int)
    corner = np.array([lower[0], upper[1]])
    total = np.zeros((rows, columns, 4), np.float32)
    weights = _weights(camera)
    for index in spread(len(images), _MOST_VIEWS):
        placement = _placement(states[index], camera, corner, grid)
        left, top, right, bottom = _footprint(placement, camera, int(columns), int(rows))
        placement[:, 2] -= (left, top)
        layered = np.dstack((images[index] * weights, weights))
        total[top:bottom, left:right] += cv2.warpAffine(layered, placement, (right - left, bottom - top))
    seen = total[..., 3] > 1e-6
    pixels = np.zeros((rows, columns, 3), np.uint8)
    pixels[seen] = np.clip(total[seen, :3] / total[seen, 3:] + 0.5, 0, 255).astype(np.uint8)
    extent = (corner[0], corner[0] + columns * grid, corner[1] - rows * grid, corner[1])
    return TopView(pixels, seen, tuple(float(value) for value in extent))


def _placement(state: np.ndarray, camera: CameraConfig, corner: np.ndarray, grid: float) -> np.ndarray:
    """(2, 3) affine map from image pixels (u right, v down) to pixels of the top view.

    The optical frame is Rz(theta) Rx(pi): image right is x turned by theta, image down is -y turned by theta.
    """
    pixel = metres_per_pixel(camera)
    cosine, sine = math.cos(state[2]), math.sin(state[2])
    turn = pixel * np.array([[cosine, sine], [sine, -cosine]])
    middle = np.array([camera.width - 1, camera.height - 1]) / 2.0
    flip = np.array([[1.0, 0.0], [0.0, -1.0]]) / grid  # rows count downwards
    offset = flip @ (state[:2] - turn @ middle - corner) - 0.5
    return np.column_stack((flip @ turn, offset))


def _footprint(placement: np.ndarray, camera: CameraConfig, columns: int, rows: int) -> Tuple[int, int, int, int]:
    """The part of a top view of so many pixels that an image may cover: left, top, and behind right and bottom.

    One pixel at least, also where the image lies outside.
    """
    outline = np.array([[0, camera.width - 1, 0, camera.width - 1], [0, 0, camera.height - 1, camera.height - 1]])
    corners = placement[:, :2] @ outline + placement[:, 2:]
    # Its colours run out within one pixel around.
    left, top = np.clip(np.floor(corners.min(axis=1)) - 1, 0, (columns - 1, rows - 1)).astype(int)
    right, bottom = np.clip(np.ceil(corners.max(axis=1)) + 2, (left + 1, top + 1), (columns, rows)).astype(int)
    return int(left), int(top), int(right), int(bottom)


def _weights(camera: CameraConfig) -> np.ndarray:
    """(H, W, 1) weight of each pixel: the middle counts most, where things that stand up are seen from above."""
    v, u = (1.0 - np.abs(np.linspace(-1.0, 1.0, size + 2)[1:-1]) for size in (camera.height, camera.width))
    return (np.minimum.outer(v, u) ** 3 + 1e-3).astype(np.float32)[..., None]
