"""Axes that show the workspace: table, path, maps over x and y, true objects, and decisions."""

from __future__ import annotations

import math
from typing import Any, Dict, Sequence, Tuple

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from embodied_active_learning.figures.style import MAP_COLOURS, MEDIUM, SMALL, UNSEEN, colour, label, style_axes
from embodied_active_learning.figures.top_view import TopView
from embodied_active_learning.objects.decision import NOT_HERE, Decision
from embodied_active_learning.objects.fingerprint import BLANK
from embodied_active_learning.objects.scoring import TrueObject, Truth
from embodied_active_learning.objects.unknown import UnknownObject
from embodied_active_learning.workspace import Workspace

Extent = Tuple[float, float, float, float]
"""Lowest x, highest x, lowest y, highest y [m]."""

FOUND = colour(1)
FALSE_CLAIM = colour(6)
"""Fill of a decision that claims an object where none of its kind stands."""

_OUTLINE = (patheffects.withStroke(linewidth=2.5, foreground="black"),)
_CROSS_STYLE: Dict[str, Any] = {"color": "white", "markeredgewidth": 1.4, "path_effects": _OUTLINE}
_CROSS_SIZE = 9  # points
_UNKNOWN_STYLE: Dict[str, Any] = {
    "marker": "D",
    "linestyle": "none",
    "markersize": 16,  # points, visible behind the marker of a decision
    "markerfacecolor": "none",
    "markeredgecolor": colour(4),
    "markeredgewidth": 1.4,
    "path_effects": _OUTLINE,
}
_MARKER_SIZE = 11  # points
_BEHIND_EXTRA = 7  # points by which a cross is larger than the marker in front of it
_MARKER_ZORDER = 4  # above texts, which have zorder 3
_ONE_LINE_WIDTH = 9.5  # inches from which on a figure has its legend in one line
_TICK = (0.04, 0.09)  # start and end of the yaw tick from the centre of a marker, as shares of the width of the axes
_CHARACTER_WIDTH = 0.6  # of most characters, in font sizes
_DASHES = (0, (4, 3))


def draw_top_view(axes: Axes, view: TopView) -> None:
    """Draw the table from above."""
    axes.set_facecolor(UNSEEN)
    pixels = np.dstack((view.pixels, np.where(view.seen, 255, 0).astype(np.uint8)))
    axes.imshow(pixels, extent=view.extent, origin="upper", interpolation="antialiased")
    _label_axes(axes)


def draw_path(axes: Axes, states: np.ndarray, workspace: Workspace, joined: bool = True) -> None:
    """Draw the path through states (N, 3) [m, m, rad], or dots if states were left out, and the workspace limits."""
    if joined:
        axes.plot(states[:, 0], states[:, 1], color="black", linewidth=0.4, alpha=0.3)
    else:
        axes.plot(states[:, 0], states[:, 1], color="black", linestyle="", marker=".", markersize=1.5, alpha=0.5)
    draw_box(axes, extent_of(workspace))


def draw_box(axes: Axes, extent: Extent, ink: str = "black") -> None:
    """Draw a dashed box, such as the workspace limits."""
    left, right, bottom, top = extent
    style: Dict[str, Any] = {"fill": False, "linestyle": _DASHES, "linewidth": 0.8, "edgecolor": ink}
    axes.add_patch(Rectangle((left, bottom), right - left, top - bottom, **style))


def draw_map(axes: Axes, values: np.ndarray, extent: Extent, limits: Tuple[float, float]) -> AxesImage:
    """Draw values (ny, nx) over the table, first row at the lowest y; return the image for a colour bar."""
    low, high = limits
    image = axes.imshow(
        values, extent=extent, origin="lower", cmap=MAP_COLOURS, vmin=low, vmax=high, interpolation="bilinear"
    )
    _label_axes(axes)
    return image


def draw_image(axes: Axes, image: np.ndarray, caption: str = "") -> None:
    """Draw an image (H, W, 3) without axes, and a caption below."""
    axes.imshow(image, interpolation="nearest")
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[:].set_visible(False)
    axes.set_xlabel(caption, fontsize=SMALL, labelpad=2)


def mark_objects(axes: Axes, objects: Sequence[TrueObject], behind: bool = False) -> None:
    """Mark the true objects with their names; set the limits of the axes first.

    behind: draw larger crosses that stay visible behind the markers of decisions.
    """
    for name, _, x, y in objects:
        axes.plot(x, y, "+", markersize=_MARKER_SIZE + _BEHIND_EXTRA if behind else _CROSS_SIZE, **_CROSS_STYLE)
        _write_beside(axes, name, (x, y), SMALL if behind else MEDIUM, above=True)


def mark_unknown(axes: Axes, unknown: Sequence[UnknownObject]) -> None:
    """Mark unknown objects, which no fingerprint matches."""
    for item in unknown:
        axes.plot(*item.place, **_UNKNOWN_STYLE)


def mark_decisions(axes: Axes, decisions: Sequence[Decision], truth: Truth) -> None:
    """Mark decisions with number, confidence and yaw; set the limits of the axes first.

    The marker is hollow if the object was not found, and a black square for a false claim.
    """
    for decision in decisions:
        x, y, _ = decision.pose
        style = marker_style(decision.found, truth.is_false_claim(decision))
        mark_pose(axes, decision.pose, decision.kind != BLANK, style)
        if decision.found:
            text: Dict[str, Any] = {"color": "white", "fontsize": SMALL, "weight": "bold", "zorder": _MARKER_ZORDER + 1}
            axes.annotate(str(decision.instance), (x, y), ha="center", va="center", **text)
        if decision.outcome != NOT_HERE:
            _write_beside(axes, decision.confidence_text, (x, y), SMALL, above=False)


def mark_pose(axes: Axes, pose: np.ndarray, with_yaw: bool, style: Dict[str, Any]) -> None:
    """Draw a marker at a pose (3,) [m, m, rad], with a tick towards its yaw; set the limits of the axes first."""
    x, y, yaw = pose
    if with_yaw:
        left, right = axes.get_xlim()
        ends = np.multiply(_TICK, right - left)
        tick = x + ends * math.cos(yaw), y + ends * math.sin(yaw)
        axes.plot(*tick, color="white", linewidth=1.6, path_effects=_OUTLINE)
    axes.plot(x, y, **style)


def marker_style(found: bool = True, is_false: bool = False) -> Dict[str, Any]:
    """Return the style of a marker: filled where an object was found, a square for a false claim, otherwise hollow."""
    fill = "none"
    if found:
        fill = FALSE_CLAIM if is_false else FOUND
    return {
        "marker": "s" if is_false else "o",
        "linestyle": "none",
        "markersize": _MARKER_SIZE,
        "markerfacecolor": fill,
        "markeredgecolor": "white",
        "markeredgewidth": 1.4,
        "path_effects": _OUTLINE,
        "zorder": _MARKER_ZORDER,
    }


def add_marker_legend(figure: Figure, with_truth: bool, down: float = 0.0, with_unknown: bool = False) -> None:
    """Add a legend of the markers, `down` inches below the top of the figure."""
    handles = [
        Line2D([], [], label="found: number, confidence, tick towards yaw", **marker_style()),
        Line2D([], [], label="not found: best candidate", **marker_style(found=False)),
    ]
    if with_truth:
        cross = {"marker": "+", "linestyle": "none", "markersize": _CROSS_SIZE, **_CROSS_STYLE}
        handles.append(Line2D([], [], label="false claim", **marker_style(is_false=True)))
        handles.append(Line2D([], [], label="true object", **cross))
    if with_unknown:
        handles.append(Line2D([], [], label="unknown object", **{**_UNKNOWN_STYLE, "markersize": _CROSS_SIZE}))
    columns = len(handles) if figure.get_figwidth() > _ONE_LINE_WIDTH else 2
    corner = (0.0, 1.0 - down / figure.get_figheight())
    figure.legend(
        handles=handles, loc="upper left", bbox_to_anchor=corner, ncols=columns, fontsize=SMALL, frameon=False
    )


def show_workspace(axes: Axes, workspace: Workspace) -> None:
    """Set the limits of the axes to those of the workspace."""
    show_extent(axes, extent_of(workspace))


def show_extent(axes: Axes, extent: Extent) -> None:
    """Set the limits of the axes."""
    axes.set_xlim(*extent[:2])
    axes.set_ylim(*extent[2:])
    _label_axes(axes)


def extent_of(workspace: Workspace) -> Extent:
    """Return the limits of the workspace in x and y."""
    return (workspace.lower[0], workspace.upper[0], workspace.lower[1], workspace.upper[1])


def _write_beside(axes: Axes, text: str, place: Tuple[float, float], size: float, above: bool) -> None:
    """Write to the right of a place, or to the left if the axes end before the text does."""
    left, right = axes.get_xlim()
    points = 72.0 / axes.figure.dpi * axes.get_window_extent().width
    room = points * (right - place[0]) / (right - left)
    side = -1 if room < min(5 + _CHARACTER_WIDTH * size * len(text), points / 2.0) else 1
    style: Dict[str, Any] = {"color": "white", "fontsize": size, "path_effects": _OUTLINE, "annotation_clip": True}
    axes.annotate(
        text,
        place,
        xytext=(5 * side, 5 if above else -6),
        textcoords="offset points",
        ha="left" if side > 0 else "right",
        va="baseline" if above else "top",
        **style,
    )


def _label_axes(axes: Axes) -> None:
    """Label x and y in metres, with equal scales and few ticks."""
    style_axes(axes)
    axes.grid(visible=False)
    axes.set_aspect("equal")
    axes.locator_params(nbins=5)
    axes.tick_params(labelsize=SMALL)
    label(axes, "x [m]", "y [m]")
