"""Pictures taken at decided places, beside what is known of the object and what its model predicts."""

from __future__ import annotations

from pathlib import Path
from typing import Sequence

import cv2
import numpy as np

from embodied_active_learning.figures.style import MEDIUM, SMALL, default_style, new_figure, save
from embodied_active_learning.objects.visits import Visit

_SIDE = 1.8  # inches of a picture
_COLUMNS = ("learned (unknown: as searched)", "predicted by the model", "picture taken")
_GAP = 4  # pixels between the pictures of a comparison


@default_style
def draw_visits(path: Path, visits: Sequence[Visit], pdf: bool = False) -> Path:
    """Draw a row for each visit, at least one. Return the path."""
    figure = new_figure(_SIDE * len(_COLUMNS) + 0.6, (_SIDE + 0.3) * len(visits) + 0.2)
    grid = figure.subplots(len(visits), len(_COLUMNS), squeeze=False)
    for title, axes in zip(_COLUMNS, grid[0]):
        axes.set_title(title, fontsize=SMALL)
    for visit, row in zip(visits, grid):
        for picture, axes in zip((visit.destination.known, visit.prediction, visit.picture), row):
            axes.set_xticks([])
            axes.set_yticks([])
            if picture is None:
                axes.set_frame_on(False)
            else:
                axes.imshow(picture)
        session, _, name = visit.destination.label.partition("/")
        row[0].set_ylabel(f"{name}\n{session}" if name else session, fontsize=MEDIUM)
        x, y = visit.destination.place
        row[2].set_xlabel(f"object at x {x:.3f} m, y {y:.3f} m", fontsize=SMALL)
    return save(figure, path, pdf)


def comparison(visit: Visit) -> np.ndarray:
    """Return what is known, the prediction and the picture side by side, (H, W', 3) uint8; no prediction is black."""
    height, width = visit.picture.shape[:2]
    known = cv2.resize(visit.destination.known, (width, height), interpolation=cv2.INTER_NEAREST)
    prediction = np.zeros_like(visit.picture) if visit.prediction is None else visit.prediction
    gap: np.ndarray = np.full((height, _GAP, 3), 255, np.uint8)
    return np.concatenate([known, gap, prediction, gap, visit.picture], axis=1)
