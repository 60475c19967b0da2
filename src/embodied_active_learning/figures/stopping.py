"""History of the stopping criterion: objects, drift, and what else must be reached."""

from __future__ import annotations

from pathlib import Path
from typing import Tuple

import numpy as np
from matplotlib.axes import Axes

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
from embodied_active_learning.model.verdict import USEFUL
from embodied_active_learning.objects.stability import MAX_DRIFT, MIN_COVERAGE
from embodied_active_learning.session.session import Session

_WIDTH, _HEIGHT = 5.5, 6.0  # inches
_SHARES: Tuple[Tuple[str, float, str], ...] = (
    ("latent_contribution", USEFUL, "contribution of\nthe latent"),
    ("coverage", MIN_COVERAGE, "coverage"),
)
_COUNTS = ("objects", "clusters"), ("undiscovered", "visible, not clustered")


@default_style
def draw_stopping(path: Path, session: Session, pdf: bool = False) -> Path:
    """Draw the checks of a session's stopping criterion over the observations, with their limits. Return the path."""
    table = session.read_table("stopping")
    observations = table["observations"]
    figure = new_figure(_WIDTH, _HEIGHT)
    counts, drift, *shares = figure.subplots(2 + len(_SHARES), 1, sharex=True)
    for index, (name, text) in enumerate(_COUNTS):
        counts.plot(observations, table[name], color=colour(index), drawstyle="steps-mid", linewidth=1.2, label=text)
    counts.legend(fontsize=SMALL, frameon=False, ncols=2)
    counts.set_ylim(-0.3, max(table[name].max() for name, _ in _COUNTS) + 1.5)
    label(counts, y="number of\nobjects")
    drift.plot(observations, 100.0 * table["drift"], color=colour(0), marker="o", markersize=3, linewidth=1.0)
    _limit(drift, 100.0 * MAX_DRIFT)
    drift.set_ylim(bottom=0.0)
    label(drift, y="drift [cm]")
    for axes, (name, limit, text) in zip(shares, _SHARES):
        axes.plot(observations, table[name], color=colour(0), linewidth=1.2)
        axes.set_ylim(min(-0.05, float(np.nanmin(table[name]))), 1.05)
        _limit(axes, limit)
        label(axes, y=text)
    for axes in (counts, drift, *shares):
        style_axes(axes)
        for stop in observations[table["stopped"] > 0]:
            axes.axvline(stop, color=colour(1), linewidth=1.0)
    label(shares[-1], "observations", shares[-1].get_ylabel())
    return save(figure, path, pdf)


def _limit(axes: Axes, value: float) -> None:
    """Draw the limit that has to be reached."""
    axes.axhline(value, color=GREY, linestyle=(0, (4, 2)), linewidth=0.8)
