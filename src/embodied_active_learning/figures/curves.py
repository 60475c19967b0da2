"""Panels of mean curves with intervals, for comparisons of groups of runs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Mapping, Sequence

import numpy as np

from embodied_active_learning.figures.style import (
    LARGE,
    SMALL,
    colour,
    default_style,
    label,
    new_figure,
    save,
    style_axes,
)

_MAX_COLUMNS = 4
_WIDTH, _HEIGHT = 3.0, 2.1  # inches, of a panel
_DECADES = 1.5
"""Decades of positive values from which on an axis is logarithmic."""


@dataclass(frozen=True)
class Curve:
    """A mean and its interval over an axis.

    Attributes:
        label: Name in the legend.
        x: (N,) positions.
        mean: (N,) means.
        low: (N,) lower ends of the interval; NaN without an interval.
        high: (N,) upper ends.
    """

    label: str
    x: np.ndarray
    mean: np.ndarray
    low: np.ndarray
    high: np.ndarray


@default_style
def draw_curves(path: Path, panels: Mapping[str, Sequence[Curve]], axis: Mapping[str, str], title: str = "") -> Path:
    """Draw a panel of curves for each quantity, with one legend.

    Args:
        path: PNG file; a PDF is written beside it.
        panels: Curves by the name of the quantity.
        axis: Label of the horizontal axis by the name of the quantity.
        title: Title of the figure.
    """
    columns = min(_MAX_COLUMNS, max(1, len(panels)))
    rows = max(1, math.ceil(len(panels) / columns))
    figure = new_figure(_WIDTH * columns, _HEIGHT * rows + 0.4)
    names = list(dict.fromkeys(curve.label for curves in panels.values() for curve in curves))
    colours = {name: colour(index) for index, name in enumerate(names)}
    grid = list(figure.subplots(rows, columns, squeeze=False).flat)
    for axes in grid[len(panels) :]:
        axes.set_axis_off()
    for axes, (name, curves) in zip(grid, panels.items()):
        for curve in curves:
            axes.plot(curve.x, curve.mean, color=colours[curve.label], linewidth=1.2, label=curve.label)
            axes.fill_between(curve.x, curve.low, curve.high, color=colours[curve.label], alpha=0.2, linewidth=0)
        if _spans_decades([curve.mean for curve in curves]):
            axes.set_yscale("log")
        style_axes(axes)
        label(axes, axis[name], name)
    if names:
        handles = {line.get_label(): line for axes in grid[: len(panels)] for line in axes.get_lines()}
        entries = [handles[name] for name in names]
        figure.legend(entries, names, loc="outside lower center", ncols=len(names), fontsize=SMALL, frameon=False)
    if title:
        figure.suptitle(title, fontsize=LARGE)
    return save(figure, path, pdf=True)


def _spans_decades(values: Sequence[np.ndarray]) -> bool:
    everything: np.ndarray = np.concatenate([np.empty(0), *(part[np.isfinite(part)] for part in values)])
    if not len(everything) or everything.min() <= 0.0:
        return False
    return bool(np.log10(everything.max() / everything.min()) > _DECADES)
