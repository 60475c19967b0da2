"""Contact sheet of a session's fingerprints: views of each learned object, and where they were taken."""

from __future__ import annotations

from pathlib import Path
from typing import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from embodied_active_learning.figures.style import (
    LARGE,
    MEDIUM,
    SMALL,
    UNSEEN,
    colour,
    default_style,
    new_figure,
    place,
    save,
    write,
)
from embodied_active_learning.figures.workspace_axes import (
    Extent,
    draw_box,
    draw_image,
    mark_objects,
    mark_pose,
    marker_style,
    show_extent,
    show_workspace,
)
from embodied_active_learning.objects.fingerprint import BLANK, Fingerprint, FingerprintSet
from embodied_active_learning.objects.scoring import TrueObject
from embodied_active_learning.subsampling import spread_indices
from embodied_active_learning.workspace import Workspace

_ROWS, _COLUMNS = 3, 6  # of the grid of views
_GAP = 0.06  # between views, in image heights
_MIN_SIDE = 0.02
"""Smallest side [m] of the enlarged part of the table."""

# Layout in inches.
_WIDTH = 12.25
_HEIGHT, _PITCH, _TOP = 2.0, 3.0, 1.2  # height of a row, distance between rows, border above the first
_LEFT = {"thumbnail": 0.25, "views": 2.45, "map": 7.25, "close": 9.95}
_VIEWS_WIDTH = 4.0


@default_style
def draw_fingerprints(path: Path, found: FingerprintSet, objects: Sequence[TrueObject] = (), pdf: bool = False) -> Path:
    """Draw a row per fingerprint: thumbnail, views in order of time, and two maps of their camera states.

    objects: the true objects, where they are known.
    """
    return save(fingerprints_figure(found, objects), path, pdf)


def fingerprints_figure(found: FingerprintSet, objects: Sequence[TrueObject] = ()) -> Figure:
    """Return the figure of draw_fingerprints."""
    count = len(found.fingerprints)
    figure = new_figure(_WIDTH, _TOP + _PITCH * max(count, 1) - 0.3, constrained=False)
    title = f"{found.session}: {count} fingerprint{'s' * (count != 1)} after {found.updates} model updates"
    marks = "Blue: camera states, arrows towards the right of the image. Orange: centre, tick towards its yaw."
    if objects:
        marks += " Crosses: true objects."
    write(figure, _LEFT["thumbnail"], 0.2, title, LARGE)
    write(figure, _LEFT["thumbnail"], 0.46, marks, SMALL)
    for index, fingerprint in enumerate(found.fingerprints):
        _draw_row(figure, _TOP + index * _PITCH, fingerprint, found.config.workspace.box(), objects)
    return figure


def _draw_row(
    figure: Figure, top: float, fingerprint: Fingerprint, workspace: Workspace, objects: Sequence[TrueObject]
) -> None:
    """Draw the row of one fingerprint."""
    write(figure, _LEFT["thumbnail"], top - 0.42, fingerprint.name, LARGE, weight="bold")
    thumbnail = place(figure, _LEFT["thumbnail"], top, _HEIGHT, _HEIGHT)
    draw_image(thumbnail, fingerprint.thumbnail, "view nearest to the centre")
    thumbnail.set_title(_facts(fingerprint), fontsize=MEDIUM, loc="left")
    shown = spread_indices(len(fingerprint.images), _ROWS * _COLUMNS)
    caption = f"{len(shown)} of {len(fingerprint.images)} views, in order of time"
    draw_image(place(figure, _LEFT["views"], top, _VIEWS_WIDTH, _HEIGHT), _montage(fingerprint.images[shown]), caption)
    _draw_map(place(figure, _LEFT["map"], top, _HEIGHT, _HEIGHT), fingerprint, workspace, objects)
    _draw_enlarged(place(figure, _LEFT["close"], top, _HEIGHT, _HEIGHT), fingerprint, objects)


def _draw_map(axes: Axes, fingerprint: Fingerprint, workspace: Workspace, objects: Sequence[TrueObject]) -> None:
    """Draw the camera states in the whole workspace."""
    axes.set_facecolor(UNSEEN)
    show_workspace(axes, workspace)
    x, y, _ = fingerprint.states.T
    axes.scatter(x, y, s=3, color=colour(0), linewidths=0)
    draw_box(axes, _enlarged_extent(fingerprint))
    mark_objects(axes, objects, behind=True)
    mark_pose(axes, fingerprint.centre, fingerprint.kind != BLANK, marker_style())
    axes.set_title("in the workspace", fontsize=MEDIUM)


def _draw_enlarged(axes: Axes, fingerprint: Fingerprint, objects: Sequence[TrueObject]) -> None:
    """Draw the camera states in the dashed box."""
    axes.set_facecolor(UNSEEN)
    show_extent(axes, _enlarged_extent(fingerprint))
    x, y, yaw = fingerprint.states.T
    axes.quiver(
        x,
        y,
        np.cos(yaw),
        np.sin(yaw),
        color=colour(0),
        angles="xy",
        units="inches",
        scale=8.0,
        width=0.012,
        pivot="tail",
    )
    mark_objects(axes, objects, behind=True)
    mark_pose(axes, fingerprint.centre, fingerprint.kind != BLANK, marker_style())
    axes.set_ylabel("")
    axes.set_title("the dashed box, enlarged", fontsize=MEDIUM)


def _facts(fingerprint: Fingerprint) -> str:
    """Kind, centre and importance in one line."""
    x, y, yaw = fingerprint.centre
    centre = f"{fingerprint.kind}, centre x {x:.3f} m, y {y:+.3f} m"
    if fingerprint.kind == BLANK:
        return centre
    return f"{centre}, yaw {yaw:+.2f} rad, {fingerprint.importance:.0%} of the importance samples"


def _montage(images: np.ndarray) -> np.ndarray:
    """Arrange views (N, H, W, 3) uint8 in rows on a white background."""
    height, width = len(images[0]), len(images[0][0])
    gap = max(1, round(_GAP * height))
    sheet: np.ndarray = np.full((_ROWS * (height + gap) - gap, _COLUMNS * (width + gap) - gap, 3), 255, np.uint8)
    for index, image in enumerate(images):
        row, column = divmod(index, _COLUMNS)
        top, left = row * (height + gap), column * (width + gap)
        sheet[top : top + height, left : left + width] = image
    return sheet


def _enlarged_extent(fingerprint: Fingerprint) -> Extent:
    """Square part of the table around all views."""
    places = np.vstack((fingerprint.states[:, :2], fingerprint.centre[:2]))
    low, high = places.min(axis=0), places.max(axis=0)
    half = 0.6 * max(float((high - low).max()), _MIN_SIDE)
    x, y = (low + high) / 2.0
    return (x - half, x + half, y - half, y + half)
