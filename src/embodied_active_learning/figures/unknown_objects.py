"""Pictures of unknown objects."""

from __future__ import annotations

from pathlib import Path
from typing import Sequence

from embodied_active_learning.figures.style import SMALL, default_style, new_figure, save
from embodied_active_learning.objects.unknown import UnknownObject

_SIDE = 1.8  # inches of a picture with its caption
MAX_IMAGES = 12


@default_style
def draw_unknown(path: Path, unknown: Sequence[UnknownObject], pdf: bool = False) -> Path:
    """Draw the largest unknown objects from above, with place and area. Return the path."""
    shown = unknown[:MAX_IMAGES]
    figure = new_figure(_SIDE * max(len(shown), 1), _SIDE + 0.4)
    for axes, item in zip(figure.subplots(1, len(shown), squeeze=False)[0], shown):
        axes.imshow(item.picture, origin="lower")
        axes.set_xticks([])
        axes.set_yticks([])
        x, y = item.place
        axes.set_title(f"x {x:.3f} m, y {y:.3f} m\n{1e4 * item.area:.0f} cm\u00b2", fontsize=SMALL)
    return save(figure, path, pdf)
