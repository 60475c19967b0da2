"""Pictures taken at decided places, beside what is known of the object and what its model predicts."""

from __future__ import annotations

from pathlib import Path
from typing import Sequence

import cv2
import numpy as np

from embodied_active_learning.figures.style import MEDIUM, SMALL, default_style, new_figure, save
from embodied_active_learning.objects.visits import Visit

_SIDE = 1.8  # inches of a picture
_COLUMNS = 3
_GAP = 4  # pixels between the pictures of a comparison


@default_style
def draw_visits(path: Path, visits: Sequence[Visit], pdf: bool = False) -> Path:
    """Draw a row for each visit, at least one. Return the path."""
    figure = new_figure(_SIDE * _COLUMNS + 0.4, (_SIDE + 0.75) * len(visits))
    for visit, part in zip(visits, figure.subfigures(len(visits), squeeze=False)[:, 0]):
        destination = visit.destination
        x, y = destination.place
        part.suptitle(f"{destination.label}\nat x {x:.3f} m, y {y:.3f} m", fontsize=MEDIUM)
        shown = (
            (destination.known, "learned" if destination.expected else "seen while searching"),
            (visit.prediction, "predicted by the model"),
            (visit.picture, "picture taken"),
        )
        for axes, (picture, caption) in zip(part.subplots(1, _COLUMNS), shown):
            axes.set_axis_off()
            if picture is not None:
                axes.imshow(picture)
                axes.set_title(caption, fontsize=SMALL, y=-0.12)
    return save(figure, path, pdf)


def comparison(visit: Visit) -> np.ndarray:
    """Return what is known, the prediction and the picture side by side, (H, W', 3) uint8; no prediction is black."""
    height, width = visit.picture.shape[:2]
    known = cv2.resize(visit.destination.known, (width, height), interpolation=cv2.INTER_NEAREST)
    prediction = np.zeros_like(visit.picture) if visit.prediction is None else visit.prediction
    gap: np.ndarray = np.full((height, _GAP, 3), 255, np.uint8)
    return np.concatenate([known, gap, prediction, gap, visit.picture], axis=1)
