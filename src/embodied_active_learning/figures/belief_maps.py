"""Belief maps of an identification: the belief of each fingerprint over x and y, and the decisions."""

from __future__ import annotations

import math
import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from embodied_active_learning.figures.style import GREY, MEDIUM, SMALL, default_style, new_figure, place, save
from embodied_active_learning.figures.top_view import TopView
from embodied_active_learning.figures.workspace_axes import (
    FALSE_CLAIM,
    FOUND,
    Extent,
    add_marker_legend,
    draw_box,
    draw_image,
    draw_map,
    draw_top_view,
    extent_of,
    mark_decisions,
    mark_objects,
    mark_unknown,
    show_extent,
)
from embodied_active_learning.objects.beliefs import above_median, shared_scale
from embodied_active_learning.objects.decision import Decision
from embodied_active_learning.objects.scoring import NO_TRUTH, Truth
from embodied_active_learning.objects.unknown import UnknownObject
from embodied_active_learning.workspace import Workspace

# Layout in inches. Explicit, because Matplotlib's layout engine takes half a minute for 60 maps.
_COLUMNS = 4
_CELL = (3.35, 2.65)  # width and height of a map with its title above and its note to the right
_MAP = 2.0  # side of a map
_THUMBNAIL = 0.85
_GAP = 0.08  # between map and note
_LEFT, _TOP, _BOTTOM = 0.65, 1.1, 1.4  # borders of the figure; the colour bar is in the lower one
_BAR_WIDTH, _BAR_HEIGHT, _BAR_BOTTOM = 4.0, 0.12, 0.8
_TITLE_WIDTH, _TITLE_LINES = 42, 3  # characters, lines
_NOTE_WIDTH = 20  # characters


@dataclass(frozen=True, eq=False)
class BeliefPanel:
    """The belief of one fingerprint and the decisions about it.

    Attributes:
        title: Up to three lines.
        thumbnail: (H, W, 3) uint8.
        x: (nx,) centres of the cells [m], equal in all panels.
        y: (ny,) centres of the cells [m], equal in all panels.
        mean: (nx, ny) largest mean over yaw.
        std: (nx, ny) standard deviation at that yaw.
        decisions: Decisions about this fingerprint.
    """

    title: str
    thumbnail: np.ndarray
    x: np.ndarray
    y: np.ndarray
    mean: np.ndarray
    std: np.ndarray
    decisions: Sequence[Decision]

    @property
    def above_median(self) -> np.ndarray:
        """(nx, ny) mean belief above its median."""
        return above_median(self.mean)


@default_style
def draw_beliefs(
    path: Path,
    workspace: Workspace,
    panels: Sequence[BeliefPanel],
    view: Optional[TopView] = None,
    truth: Truth = NO_TRUTH,
    pdf: bool = False,
    unknown: Sequence[UnknownObject] = (),
    by_views: bool = False,
) -> Path:
    """Draw the table from above and the belief map of every fingerprint, with one colour scale.

    by_views: whether the decisions compare views, so that the maps do not explain them.
    """
    return save(beliefs_figure(workspace, panels, view, truth, unknown, by_views), path, pdf)


def beliefs_figure(
    workspace: Workspace,
    panels: Sequence[BeliefPanel],
    view: Optional[TopView] = None,
    truth: Truth = NO_TRUTH,
    unknown: Sequence[UnknownObject] = (),
    by_views: bool = False,
) -> Figure:
    """Return the figure of draw_beliefs."""
    before = int(view is not None)
    count = before + len(panels)
    rows = max(1, math.ceil(count / _COLUMNS))
    columns = max(2, math.ceil(count / rows))
    height = _TOP + (rows - 1) * _CELL[1] + _MAP + _BOTTOM
    figure = new_figure(_LEFT + columns * _CELL[0], height, constrained=False)
    corners = [(_LEFT + i % columns * _CELL[0], _TOP + i // columns * _CELL[1]) for i in range(count)]
    maps = [place(figure, left, top, _MAP, _MAP) for left, top in corners]
    if view is not None:
        _draw_view(maps[0], view, workspace, _extent(panels[0]) if panels else extent_of(workspace), truth)
    limits, image = (0.0, shared_scale(panel.above_median for panel in panels)), None
    for axes, (left, top), panel in zip(maps[before:], corners[before:], panels):
        image = _draw_map(axes, panel, limits, workspace, truth)
        _draw_note(place(figure, left + _MAP + _GAP, top, _THUMBNAIL, _THUMBNAIL), panel, truth)
    for axes in maps:
        mark_unknown(axes, unknown)
    if image is not None:
        _add_colour_bar(figure, image, by_views)
    _remove_inner_labels(maps, columns)
    add_marker_legend(figure, bool(truth.objects), with_unknown=bool(unknown))
    return figure


def _remove_inner_labels(maps: Sequence[Axes], columns: int) -> None:
    """Keep the labels of the first column and of the last map in each column."""
    for index, axes in enumerate(maps):
        if index % columns:
            axes.set_ylabel("")
            axes.tick_params(labelleft=False)
        if index + columns < len(maps):
            axes.set_xlabel("")
            axes.tick_params(labelbottom=False)


def _add_colour_bar(figure: Figure, image: AxesImage, by_views: bool) -> None:
    """Add the colour bar of all maps below them."""
    top = figure.get_figheight() - _BAR_BOTTOM
    bar = figure.colorbar(image, cax=place(figure, _LEFT, top, _BAR_WIDTH, _BAR_HEIGHT), orientation="horizontal")
    caption = "belief above the median of its map (same scale in all maps)"
    if by_views:
        caption += "\ndecisions compare views: see evidence.png"
    bar.set_label(caption, fontsize=SMALL)
    bar.ax.tick_params(labelsize=SMALL)


def _draw_view(axes: Axes, view: TopView, workspace: Workspace, extent: Extent, truth: Truth) -> None:
    """Draw the table from above."""
    draw_top_view(axes, view)
    show_extent(axes, extent)
    draw_box(axes, extent_of(workspace))
    mark_objects(axes, truth.objects)
    axes.set_title("camera images", fontsize=MEDIUM, loc="left")


def _draw_map(
    axes: Axes, panel: BeliefPanel, limits: Tuple[float, float], workspace: Workspace, truth: Truth
) -> AxesImage:
    """Draw one belief map with its decisions."""
    extent = _extent(panel)
    image = draw_map(axes, panel.above_median.T, extent, limits)
    show_extent(axes, extent)
    draw_box(axes, extent_of(workspace), "white")
    mark_objects(axes, truth.objects, behind=True)
    mark_decisions(axes, panel.decisions, truth)
    wrapped = (textwrap.wrap(line, _TITLE_WIDTH, max_lines=2, placeholder=" ...") for line in panel.title.splitlines())
    lines = [part for parts in wrapped for part in parts]
    axes.set_title("\n".join(lines[:_TITLE_LINES]), fontsize=MEDIUM, loc="left")
    return image


def _draw_note(axes: Axes, panel: BeliefPanel, truth: Truth) -> None:
    """Draw the thumbnail with the outcome and the belief in numbers below."""
    draw_image(axes, panel.thumbnail)
    std = panel.std.flat[panel.mean.argmax()]
    outcome, ink, reason = _outcome(panel.decisions, truth)
    lines = [*reason, "belief", f"median {np.median(panel.mean):.2f}", f"peak {panel.mean.max():.2f} \u00b1 {std:.2f}"]
    style: Dict[str, Any] = {"transform": axes.transAxes, "va": "top", "fontsize": SMALL, "linespacing": 1.3}
    axes.text(0.0, -0.09, outcome, color=ink, weight="bold", **style)
    axes.text(0.0, -0.31, "\n".join(lines), **style)


def _outcome(decisions: Sequence[Decision], truth: Truth) -> Tuple[str, str, List[str]]:
    """Outcome, its colour, and the reason as short lines if the object was not found."""
    found = sum(decision.found for decision in decisions)
    false_claims = sum(map(truth.is_false_claim, decisions))
    if false_claims:
        return f"false: {false_claims} of {found}", FALSE_CLAIM, []
    if found:
        return f"found {found} times" if found > 1 else "found", FOUND, []
    if not decisions:
        return "not decided", GREY, []
    return decisions[0].outcome, GREY, textwrap.wrap(decisions[0].reason, _NOTE_WIDTH)


def _extent(panel: BeliefPanel) -> Extent:
    """Outer edges of the cells."""
    half_x, half_y = (panel.x[1] - panel.x[0]) / 2.0, (panel.y[1] - panel.y[0]) / 2.0
    return (panel.x[0] - half_x, panel.x[-1] + half_x, panel.y[0] - half_y, panel.y[-1] + half_y)
