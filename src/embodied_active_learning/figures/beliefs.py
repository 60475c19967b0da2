"""Where the fingerprints are believed to be, and where they were found."""

from __future__ import annotations

import math
import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import List, Optional, Sequence, Tuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from embodied_active_learning.figures.mosaic import TopView
from embodied_active_learning.figures.style import GREY, MEDIUM, SMALL, new_figure, place, save
from embodied_active_learning.figures.views import (
    FOUND,
    Extent,
    draw_image,
    draw_limits,
    draw_map,
    draw_top_view,
    explain_marks,
    extent_of,
    mark_decisions,
    mark_objects,
    show_extent,
)
from embodied_active_learning.geometry import Location
from embodied_active_learning.objects.decision import Decision
from embodied_active_learning.workspace import Workspace

# Everything has its place in inches: to find one for 60 maps would take matplotlib half a minute.
_COLUMNS = 4
_CELL = (3.35, 2.65)  # a map, its title above it and its note to the right
_MAP = 2.0  # the side of a map, if it is square
_THUMBNAIL = 0.85
_GAP = 0.08
_LEFT, _TOP, _BOTTOM = 0.65, 1.1, 0.55  # borders of the figure
_TITLE_WIDTH, _TITLE_LINES = 42, 3  # letters
_NOTE_WIDTH = 20
_LEAST_RANGE = 1e-6


@dataclass(frozen=True, eq=False)
class BeliefPanel:
    """What is believed of one fingerprint, and what was decided."""

    title: str  # up to three lines
    thumbnail: np.ndarray  # (H, W, 3) uint8
    x: np.ndarray  # (nx,) m, middles of the cells, the same in all panels
    y: np.ndarray  # (ny,) m
    mean: np.ndarray  # (nx, ny) largest mean over yaw
    std: np.ndarray  # (nx, ny) standard deviation there
    decisions: Sequence[Decision]  # this fingerprint's alone


def draw_beliefs(
    path: Path,
    workspace: Workspace,
    panels: Sequence[BeliefPanel],
    view: Optional[TopView] = None,
    objects: Sequence[Location] = (),
) -> Path:
    """What the camera saw from above, then the belief of every fingerprint, each with colours of its own."""
    return save(beliefs_figure(workspace, panels, view, objects), path)


def beliefs_figure(
    workspace: Workspace,
    panels: Sequence[BeliefPanel],
    view: Optional[TopView] = None,
    objects: Sequence[Location] = (),
) -> Figure:
    """The same, not yet written."""
    before = int(view is not None)
    count = before + len(panels)
    rows = max(1, math.ceil(count / _COLUMNS))
    columns = max(2, math.ceil(count / rows))
    figure = new_figure(_LEFT + columns * _CELL[0], _TOP + (rows - 1) * _CELL[1] + _MAP + _BOTTOM, arranged=False)
    corners = [(_LEFT + i % columns * _CELL[0], _TOP + i // columns * _CELL[1]) for i in range(count)]
    maps = [place(figure, left, top, _MAP, _MAP) for left, top in corners]
    if view is not None:
        _draw_view(maps[0], view, workspace, _extent(panels[0]) if panels else extent_of(workspace), objects)
    for axes, (left, top), panel in zip(maps[before:], corners[before:], panels):
        _draw_map(axes, panel, workspace, objects)
        _draw_note(place(figure, left + _MAP + _GAP, top, _THUMBNAIL, _THUMBNAIL), panel)
    for index, axes in enumerate(maps):
        if index % columns:
            axes.set_ylabel("")
            axes.tick_params(labelleft=False)
        if index + columns < count:
            axes.set_xlabel("")
            axes.tick_params(labelbottom=False)
    explain_marks(figure, objects=bool(objects))
    return figure


def _draw_view(axes: Axes, view: TopView, workspace: Workspace, extent: Extent, objects: Sequence[Location]) -> None:
    draw_top_view(axes, view)
    show_extent(axes, extent)
    draw_limits(axes, extent_of(workspace))
    mark_objects(axes, objects)
    axes.set_title("what the camera saw", fontsize=MEDIUM, loc="left")


def _draw_map(axes: Axes, panel: BeliefPanel, workspace: Workspace, objects: Sequence[Location]) -> None:
    extent = _extent(panel)
    draw_map(axes, panel.mean.T, extent, _colour_limits(panel))
    show_extent(axes, extent)
    draw_limits(axes, extent_of(workspace), "white")
    mark_objects(axes, objects, behind=True)
    mark_decisions(axes, panel.decisions)
    wrapped = (textwrap.wrap(line, _TITLE_WIDTH, max_lines=2, placeholder=" ...") for line in panel.title.splitlines())
    lines = [part for parts in wrapped for part in parts]
    axes.set_title("\n".join(lines[:_TITLE_LINES]), fontsize=MEDIUM, loc="left")


def _draw_note(axes: Axes, panel: BeliefPanel) -> None:
    """The thumbnail, and below it what was decided and the belief in figures."""
    draw_image(axes, panel.thumbnail)
    low, high = _colour_limits(panel)
    std = panel.std.flat[panel.mean.argmax()]
    outcome, ink, reason = _outcome(panel.decisions)
    lines = [*reason, "belief", f"median {low:.2f} (dark)", f"peak {high:.2f} \u00b1 {std:.2f}"]
    style = {"transform": axes.transAxes, "va": "top", "fontsize": SMALL, "linespacing": 1.3}
    axes.text(0.0, -0.09, outcome, color=ink, weight="bold", **style)
    axes.text(0.0, -0.31, "\n".join(lines), **style)


def _outcome(decisions: Sequence[Decision]) -> Tuple[str, str, List[str]]:
    """What was decided, its colour, and in short lines why, where it was not found."""
    found = sum(decision.found for decision in decisions)
    if found:
        return f"found {found} times" if found > 1 else "found", FOUND, []
    if not decisions:
        return "not decided", GREY, []
    return "not found", GREY, textwrap.wrap(decisions[0].reason, _NOTE_WIDTH)


def _colour_limits(panel: BeliefPanel) -> Tuple[float, float]:
    """From the median, because nearly all of a map is background and the rest lies a few hundredths above it."""
    low = float(np.median(panel.mean))
    return low, max(float(panel.mean.max()), low + _LEAST_RANGE)


def _extent(panel: BeliefPanel) -> Extent:
    """The outer edges of the cells."""
    half_x, half_y = (panel.x[1] - panel.x[0]) / 2.0, (panel.y[1] - panel.y[0]) / 2.0
    return (panel.x[0] - half_x, panel.x[-1] + half_x, panel.y[0] - half_y, panel.y[-1] + half_y)
