"""What the latents carry: images decoded from their own latent, from another's, and from none."""

from __future__ import annotations

from pathlib import Path
from typing import List, Sequence, Tuple

import cv2
import numpy as np

from embodied_active_learning.figures.style import MEDIUM, SMALL, new_figure, save
from embodied_active_learning.figures.views import draw_image
from embodied_active_learning.model.trained_model import TrainedModel
from embodied_active_learning.session.observations import Observations

_COLUMNS = 8
_THUMBNAIL = (6, 6)
_LEAST_CONTRAST = 0.1  # of the largest contrast: where objects are rare, the better half still holds bare table
_AXIS_WEIGHTS = (1.0, 1.0, 0.3)  # of x, y and theta when places are told apart: turning shows the same object again


def draw_reconstructions(path: Path, model: TrainedModel, seen: Observations, columns: int = _COLUMNS) -> Path:
    """Rows: observed, own latent, shuffled latent, no latent; columns: observations of all objects, and a blank."""
    chosen = spread_of_images(seen.images, seen.states, columns)
    states, images = seen.raw_states[chosen], seen.images[chosen]
    latents, _ = model.encode(states, images)
    sources = {
        "own latent": latents,
        "another's\nlatent": np.roll(latents, 1, axis=0),
        "no latent\n(z = 0)": np.zeros_like(latents),
    }
    figure = new_figure(0.8 + 1.15 * len(chosen), 5.7)
    grid = figure.subplots(1 + len(sources), len(chosen), squeeze=False)
    figure.get_layout_engine().set(w_pad=0.02, h_pad=0.03, wspace=0.02, hspace=0.02)
    _draw_row(grid[0], "observed", images, [""] * len(chosen))
    for axes, (x, y, theta) in zip(grid[0], states):
        axes.set_title(f"x {x:.2f} m\ny {y:+.2f} m\n$\\theta$ {theta:+.2f} rad", fontsize=SMALL)
    for row, (name, source) in zip(grid[1:], sources.items()):
        _draw_row(row, name, *_predict(model, source, states))
    figure.supxlabel(r"$\sigma$: predicted standard deviation of a grey level in [0, 1]", fontsize=SMALL)
    return save(figure, path)


def spread_of_images(images: np.ndarray, states: np.ndarray, count: int) -> np.ndarray:
    """Indices of at most `count` observations in order of time: one that shows little, the others much, far apart.

    images: (N, H, W, 3) uint8; states: (N, 3) normalised. By place rather than by likeness of the images: an object of
    little contrast would never be the least alike.
    """
    contrast = _contrast(images)
    order = np.argsort(contrast)
    striking = order[len(order) // 2 :]
    striking = striking[contrast[striking] >= _LEAST_CONTRAST * contrast.max()]
    places = states[striking] * _AXIS_WEIGHTS
    chosen = [len(striking) - 1]
    nearest = np.full(len(striking), np.inf)
    while len(chosen) < min(count - 1, len(striking)):
        nearest = np.minimum(nearest, np.square(places - places[chosen[-1]]).sum(axis=1))
        chosen.append(int(nearest.argmax()))
    return np.unique([order[0], *striking[chosen]])


def _contrast(images: np.ndarray) -> np.ndarray:
    """(N,) how much each image (N, H, W, 3) differs from what is mostly seen: the bare table."""
    thumbnails = (cv2.resize(image, _THUMBNAIL, interpolation=cv2.INTER_AREA) for image in images)
    # Colours as the eye tells them apart: in RGB a yellow object is nearly a bright table.
    features = np.stack([cv2.cvtColor(thumbnail, cv2.COLOR_RGB2LAB) for thumbnail in thumbnails]).astype(np.float32)
    return np.square(features - np.median(features, axis=0)).sum(axis=(1, 2, 3))


def _predict(model: TrainedModel, latents: np.ndarray, states: np.ndarray) -> Tuple[np.ndarray, List[str]]:
    means, stds = model.decode(latents, states)
    return means, [rf"$\sigma$ {std:.3f}" for std in stds]


def _draw_row(row: np.ndarray, name: str, images: np.ndarray, captions: Sequence[str]) -> None:
    for axes, image, caption in zip(row, images, captions):
        draw_image(axes, image, caption)
    row[0].set_ylabel(name, fontsize=MEDIUM, rotation=0, ha="right", va="center", labelpad=6)
