"""Reconstructions of images from their own latent, another image's latent, and no latent."""

from __future__ import annotations

from pathlib import Path
from typing import List, Sequence, Tuple

import cv2
import numpy as np

from embodied_active_learning.figures.style import MEDIUM, SMALL, default_style, new_figure, save, set_padding
from embodied_active_learning.figures.workspace_axes import draw_image
from embodied_active_learning.model.trained_model import TrainedModel
from embodied_active_learning.session.observations import Observations

_COLUMNS = 8
_THUMBNAIL = (6, 6)  # px
_MIN_CONTRAST = 0.1
"""Share of the largest contrast that an image of an object needs; if objects are rare, half the images are too many."""
_STATE_WEIGHTS = (1.0, 1.0, 0.3)
"""Weights of x, y and theta in the distance between images: a rotated camera shows the same object."""


@default_style
def draw_reconstructions(path: Path, model: TrainedModel, observations: Observations, pdf: bool = False) -> Path:
    """Draw images of all objects and of the table, and their reconstructions from own, shuffled and no latent."""
    chosen = select_images(observations.images, observations.states, _COLUMNS)
    states, images = observations.raw_states[chosen], observations.images[chosen]
    latents, _ = model.encode(states, images)
    sources = {
        "own latent": latents,
        "another's\nlatent": np.roll(latents, 1, axis=0),
        "no latent\n(z = 0)": np.zeros_like(latents),
    }
    figure = new_figure(0.8 + 1.15 * len(chosen), 5.7)
    grid = figure.subplots(1 + len(sources), len(chosen), squeeze=False)
    set_padding(figure, w_pad=0.02, h_pad=0.03, wspace=0.02, hspace=0.02)
    _draw_row(grid[0], "observed", images, [""] * len(chosen))
    for axes, (x, y, theta) in zip(grid[0], states):
        axes.set_title(f"x {x:.2f} m\ny {y:+.2f} m\n$\\theta$ {theta:+.2f} rad", fontsize=SMALL)
    for row, (name, source) in zip(grid[1:], sources.items()):
        _draw_row(row, name, *_predict(model, source, states))
    figure.supxlabel(r"$\sigma$: predicted standard deviation of a grey level in [0, 1]", fontsize=SMALL)
    return save(figure, path, pdf)


def select_images(images: np.ndarray, states: np.ndarray, count: int) -> np.ndarray:
    """Return the indices of at most `count` images in order of time: one of the bare table, the others of objects.

    Images of objects are selected far apart by state, not by difference of images: an object with low contrast would
    never be selected.

    Args:
        images: (N, H, W, 3) uint8.
        states: (N, 3) normalised states.
        count: Largest number of images.
    """
    contrast = _contrast(images)
    order = np.argsort(contrast)
    objects = order[len(order) // 2 :]
    objects = objects[contrast[objects] >= _MIN_CONTRAST * contrast.max()]
    places = states[objects] * _STATE_WEIGHTS
    chosen = [len(objects) - 1]
    nearest = np.full(len(objects), np.inf)
    while len(chosen) < min(count - 1, len(objects)):
        nearest = np.minimum(nearest, np.square(places - places[chosen[-1]]).sum(axis=1))
        chosen.append(int(nearest.argmax()))
    return np.unique([order[0], *objects[chosen]])


def _contrast(images: np.ndarray) -> np.ndarray:
    """Difference (N,) of each image (N, H, W, 3) from the median image, the bare table."""
    thumbnails = (cv2.resize(image, _THUMBNAIL, interpolation=cv2.INTER_AREA) for image in images)
    # CIELAB, because a yellow object is close to a bright table in RGB.
    features = np.stack([cv2.cvtColor(thumbnail, cv2.COLOR_RGB2LAB) for thumbnail in thumbnails]).astype(np.float32)
    return np.square(features - np.median(features, axis=0)).sum(axis=(1, 2, 3))


def _predict(model: TrainedModel, latents: np.ndarray, states: np.ndarray) -> Tuple[np.ndarray, List[str]]:
    """Decoded images and captions with the predicted standard deviation."""
    means, stds = model.decode(latents, states)
    return means, [rf"$\sigma$ {std:.3f}" for std in stds]


def _draw_row(row: np.ndarray, name: str, images: np.ndarray, captions: Sequence[str]) -> None:
    """Draw one row of images."""
    for axes, image, caption in zip(row, images, captions):
        draw_image(axes, image, caption)
    row[0].set_ylabel(name, fontsize=MEDIUM, rotation=0, ha="right", va="center", labelpad=6)
