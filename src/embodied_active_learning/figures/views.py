"""The workspace as a picture with axes: the table, the path over it, the objects on it and where they were found."""

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

from embodied_active_learning.figures.mosaic import TopView
from embodied_active_learning.figures.style import MAP_COLOURS, MEDIUM, SMALL, UNSEEN, colour, label, quiet
from embodied_active_learning.geometry import Location
from embodied_active_learning.objects.decision import Decision
from embodied_active_learning.objects.fingerprint import BLANK
from embodied_active_learning.workspace import Workspace

Extent = Tuple[float, float, float, float]  # m: lowest x, highest x, lowest y, highest y

FOUND = colour(1)

_OUTLINE = (patheffects.withStroke(linewidth=2.5, foreground="black"),)
_CROSS_STYLE = {"color": "white", "markeredgewidth": 1.4, "path_effects": _OUTLINE}
_CROSS = 9  # points across
_MARKER = 11
_ABOVE_NAMES = 4  # matplotlib's order of drawing: texts have 3
_WIDE = 9.5  # inches of a figure on which all marks are explained in one line
_TICK = (0.04, 0.09)  # beginning and end, from the middle of the marker, of the width of the axes
_LETTER = 0.6  # width of most letters, of their size


def draw_top_view(axes: Axes, view: TopView) -> None:
    """The table from above."""
    axes.set_facecolor(UNSEEN)
    pixels = np.dstack((view.pixels, np.where(view.seen, 255, 0).astype(np.uint8)))
    axes.imshow(pixels, extent=view.extent, origin="upper", interpolation="antialiased")
    _name_axes(axes)


def draw_path(axes: Axes, states: np.ndarray, workspace: Workspace) -> None:
    """The travelled path (N, 3) in m, m, rad, and the limits of the workspace."""
    axes.plot(states[:, 0], states[:, 1], color="black", linewidth=0.4, alpha=0.3)
    draw_limits(axes, extent_of(workspace))


def draw_limits(axes: Axes, extent: Extent, ink: str = "black") -> None:
    """A dashed box, such as the limits of the workspace."""
    left, right, bottom, top = extent
    dashes = (0, (4, 3))
    axes.add_patch(
        Rectangle(
            (left, bottom), right - left, top - bottom, fill=False, linestyle=dashes, linewidth=0.8, edgecolor=ink
        )
    )


def draw_map(axes: Axes, values: np.ndarray, extent: Extent, limits: Tuple[float, float]) -> AxesImage:
    """Values (ny, nx) over the table, the first row at the lowest y. -> the picture, for a colour bar."""
    low, high = limits
    picture = axes.imshow(
        values, extent=extent, origin="lower", cmap=MAP_COLOURS, vmin=low, vmax=high, interpolation="bilinear"
    )
    _name_axes(axes)
    return picture


def draw_image(axes: Axes, image: np.ndarray, caption: str = "") -> None:
    """An image (H, W, 3) as it is, without axes, and a line below it."""
    axes.imshow(image, interpolation="nearest")
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[:].set_visible(False)
    axes.set_xlabel(caption, fontsize=SMALL, labelpad=2)


def mark_objects(axes: Axes, objects: Sequence[Location], behind: bool = False) -> None:
    """Where the objects really are; behind: wider, so that they show behind the markers of decisions.

    The axes must have their limits already.
    """
    for name, x, y in objects:
        axes.plot(x, y, "+", markersize=_MARKER + 7 if behind else _CROSS, **_CROSS_STYLE)
        _write_beside(axes, name, (x, y), SMALL if behind else MEDIUM, above=True)


def mark_decisions(axes: Axes, decisions: Sequence[Decision]) -> None:
    """Where a fingerprint was found: number, confidence, and yaw; hollow where it fitted best but was not found.

    The axes must have their limits already. A blank has no yaw.
    """
    for decision in decisions:
        x, y, _ = decision.pose
        mark_pose(axes, decision.pose, decision.kind != BLANK, decision.found)
        if decision.found:
            number = str(decision.instance)
            style = {"color": "white", "fontsize": SMALL, "weight": "bold", "zorder": _ABOVE_NAMES + 1}
            axes.annotate(number, (x, y), ha="center", va="center", **style)
        _write_beside(axes, f"{decision.confidence:.0%}", (x, y), SMALL, above=False)


def mark_pose(axes: Axes, pose: np.ndarray, with_yaw: bool, filled: bool = True) -> None:
    """A round marker at a pose (3,) [m, m, rad], with a tick towards its yaw. The axes must have their limits."""
    x, y, yaw = pose
    if with_yaw:
        left, right = axes.get_xlim()
        ends = np.multiply(_TICK, right - left)
        axes.plot(
            x + ends * math.cos(yaw), y + ends * math.sin(yaw), color="white", linewidth=1.6, path_effects=_OUTLINE
        )
    axes.plot(x, y, **_marker_style(filled))


def explain_marks(figure: Figure, objects: bool, down: float = 0.0) -> None:
    """Say what the marks of decisions mean, and those of objects where there are any; down: inches from the top."""
    handles = [
        Line2D(
            [], [], label="found: number, share of the views that agree, tick towards its yaw", **_marker_style(True)
        ),
        Line2D([], [], label="fitted best here, but was not found", **_marker_style(False)),
    ]
    if objects:
        cross = {"marker": "+", "linestyle": "none", "markersize": _CROSS, **_CROSS_STYLE}
        handles.append(Line2D([], [], label="where an object really is", **cross))
    columns = len(handles) if figure.get_figwidth() > _WIDE else 1
    corner = (0.0, 1.0 - down / figure.get_figheight())
    figure.legend(
        handles=handles, loc="upper left", bbox_to_anchor=corner, ncols=columns, fontsize=SMALL, frameon=False
    )


def show_workspace(axes: Axes, workspace: Workspace) -> None:
    """Let the axes end where the workspace does."""
    show_extent(axes, extent_of(workspace))


def show_extent(axes: Axes, extent: Extent) -> None:
    """Let the axes end there."""
    axes.set_xlim(*extent[:2])
    axes.set_ylim(*extent[2:])
    _name_axes(axes)


def extent_of(workspace: Workspace) -> Extent:
    """The workspace's limits in x and y."""
    return (workspace.lower[0], workspace.upper[0], workspace.lower[1], workspace.upper[1])


def _marker_style(found: bool) -> Dict[str, Any]:
    inside = FOUND if found else "none"
    return {
        "marker": "o",
        "linestyle": "none",
        "markersize": _MARKER,
        "markerfacecolor": inside,
        "markeredgecolor": "white",
        "markeredgewidth": 1.4,
        "path_effects": _OUTLINE,
        "zorder": _ABOVE_NAMES,
    }


def _write_beside(axes: Axes, text: str, place: Tuple[float, float], size: float, above: bool) -> None:
    """Write to the right of a place, or to the left where the axes end too soon."""
    left, right = axes.get_xlim()
    points = 72.0 * axes.get_position().width * axes.figure.get_figwidth()
    room = points * (right - place[0]) / (right - left)
    side = -1 if room < min(5 + _LETTER * size * len(text), points / 2.0) else 1
    axes.annotate(
        text,
        place,
        xytext=(5 * side, 5 if above else -6),
        textcoords="offset points",
        ha="left" if side > 0 else "right",
        va="baseline" if above else "top",
        color="white",
        fontsize=size,
        path_effects=_OUTLINE,
        annotation_clip=True,
    )


def _name_axes(axes: Axes) -> None:
    quiet(axes)
    axes.grid(visible=False)
    axes.set_aspect("equal")
    axes.locator_params(nbins=5)
    axes.tick_params(labelsize=SMALL)
    label(axes, "x [m]", "y [m]")
