"""Shares with their intervals, one line for each group, side by side for several quantities."""

from __future__ import annotations

from pathlib import Path
from typing import Mapping, Optional, Tuple

from embodied_active_learning.figures.style import (
    GREY,
    SMALL,
    colour,
    default_style,
    label,
    new_figure,
    save,
    style_axes,
)

Interval = Tuple[float, float, float]
"""Share, and the lower and upper end of its interval, from 0 to 1."""
_WIDTH, _LINE = 3.2, 0.22  # inches


@default_style
def draw_shares(path: Path, panels: Mapping[str, Mapping[str, Optional[Interval]]], aims: Mapping[str, float]) -> Path:
    """Draw a panel of points with intervals for each quantity.

    Args:
        path: PNG file; a PDF is written beside it.
        panels: By the name of the quantity, the interval of each group. All have the same groups; a group without an
            interval has no point.
        aims: By the name of the quantity, the share to be reached, drawn as a dashed line.
    """
    groups = list(next(iter(panels.values())))
    figure = new_figure(1.3 + _WIDTH * len(panels), 0.7 + _LINE * len(groups))
    columns = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for index, (axes, (name, shares)) in enumerate(zip(columns, panels.items())):
        for line, group in enumerate(groups):
            interval = shares[group]
            if interval is None:
                continue
            value, low, high = (100.0 * part for part in interval)
            axes.plot([low, high], [line, line], color=colour(index), linewidth=1.2)
            axes.plot([value], [line], "o", color=colour(index), markersize=4)
        if name in aims:
            axes.axvline(100.0 * aims[name], color=GREY, linewidth=0.8, linestyle="--")
        style_axes(axes)
        label(axes, f"{name} [%]", "")
        axes.set_yticks(range(len(groups)), groups, fontsize=SMALL)
        axes.margins(x=0.04)
    columns[0].set_ylim(len(groups) - 0.5, -0.5)
    return save(figure, path, pdf=True)
