"""The contact sheet of fingerprints: what each learned object looks like, and where its views were taken."""

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
    new_figure,
    place,
    save,
    spread,
    write,
)
from embodied_active_learning.figures.views import (
    Extent,
    draw_image,
    draw_limits,
    mark_objects,
    mark_pose,
    show_extent,
    show_workspace,
)
from embodied_active_learning.geometry import Location
from embodied_active_learning.objects.fingerprint import BLANK, Fingerprint, FingerprintSet
from embodied_active_learning.workspace import Workspace

_ROWS, _COLUMNS = 3, 6  # of shown views
_GAP = 0.06  # between views, of their size
# Inches: height of what a row shows, from one row to the next, and the border above.
_HEIGHT, _PITCH, _TOP = 2.0, 3.0, 1.2
_WIDTH = 12.25
_LEFT = {"thumbnail": 0.25, "views": 2.45, "map": 7.25, "close": 9.95}  # inches
_LEAST_SIDE = 0.02  # m, of the part of the table that is shown closely


def draw_fingerprints(path: Path, found: FingerprintSet, objects: Sequence[Location] = ()) -> Path:
    """One row for each fingerprint: thumbnail, views spread over time, and two maps of where they were taken.

    objects: name, x [m], y [m] of what really stands on the table, where that is known.
    """
    return save(fingerprints_figure(found, objects), path)


def fingerprints_figure(found: FingerprintSet, objects: Sequence[Location] = ()) -> Figure:
    """The same, not yet written."""
    count = len(found.fingerprints)
    figure = new_figure(_WIDTH, _TOP + _PITCH * max(count, 1) - 0.3, arranged=False)
    title = f"{found.session}: {count} fingerprint{'s' * (count != 1)} after {found.updates} model updates"
    marks = (
        "Blue: the camera's places, arrows towards the right of its images. Orange: the centre, tick towards its yaw."
    )
    if objects:
        marks += " Crosses: where the objects really are."
    write(figure, _LEFT["thumbnail"], 0.2, title, LARGE)
    write(figure, _LEFT["thumbnail"], 0.46, marks, SMALL)
    for index, fingerprint in enumerate(found.fingerprints):
        _draw_row(figure, _TOP + index * _PITCH, fingerprint, found.config.workspace.box(), objects)
    return figure


def _draw_row(
    figure: Figure, top: float, fingerprint: Fingerprint, workspace: Workspace, objects: Sequence[Location]
) -> None:
    write(figure, _LEFT["thumbnail"], top - 0.42, fingerprint.name, LARGE, weight="bold")
    views = _LEFT["map"] - _LEFT["views"] - 0.8
    thumbnail = place(figure, _LEFT["thumbnail"], top, _HEIGHT, _HEIGHT)
    draw_image(thumbnail, fingerprint.thumbnail, "the view nearest to the centre")
    thumbnail.set_title(_facts(fingerprint), fontsize=MEDIUM, loc="left")
    shown = spread(len(fingerprint.images), _ROWS * _COLUMNS)
    caption = f"{len(shown)} of {len(fingerprint.images)} views, in the order in which they were taken"
    draw_image(place(figure, _LEFT["views"], top, views, _HEIGHT), _montage(fingerprint.images[shown]), caption)
    _draw_map(place(figure, _LEFT["map"], top, _HEIGHT, _HEIGHT), fingerprint, workspace, objects)
    _draw_close(place(figure, _LEFT["close"], top, _HEIGHT, _HEIGHT), fingerprint, objects)


def _draw_map(axes: Axes, fingerprint: Fingerprint, workspace: Workspace, objects: Sequence[Location]) -> None:
    """The whole workspace."""
    axes.set_facecolor(UNSEEN)
    show_workspace(axes, workspace)
    axes.scatter(*fingerprint.states.T[:2], s=3, color=colour(0), linewidths=0)
    draw_limits(axes, _close_extent(fingerprint))
    mark_objects(axes, objects, behind=True)
    mark_pose(axes, fingerprint.centre, fingerprint.kind != BLANK)
    axes.set_title("in the workspace", fontsize=MEDIUM)


def _draw_close(axes: Axes, fingerprint: Fingerprint, objects: Sequence[Location]) -> None:
    """The dashed part of the workspace."""
    axes.set_facecolor(UNSEEN)
    show_extent(axes, _close_extent(fingerprint))
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
    mark_pose(axes, fingerprint.centre, fingerprint.kind != BLANK)
    axes.set_ylabel("")
    axes.set_title("the dashed box, enlarged", fontsize=MEDIUM)


def _facts(fingerprint: Fingerprint) -> str:
    x, y, yaw = fingerprint.centre
    centre = f"{fingerprint.kind}, centre x {x:.3f} m, y {y:+.3f} m"
    if fingerprint.kind == BLANK:
        return centre
    return f"{centre}, yaw {yaw:+.2f} rad, {fingerprint.importance:.0%} of the importance samples"


def _montage(images: np.ndarray) -> np.ndarray:
    """Views (N, H, W, 3) in rows on one white sheet, uint8."""
    height, width = images.shape[1:3]
    gap = max(1, round(_GAP * height))
    sheet = np.full((_ROWS * (height + gap) - gap, _COLUMNS * (width + gap) - gap, 3), 255, np.uint8)
    for index, image in enumerate(images):
        row, column = divmod(index, _COLUMNS)
        top, left = row * (height + gap), column * (width + gap)
        sheet[top : top + height, left : left + width] = image
    return sheet


def _close_extent(fingerprint: Fingerprint) -> Extent:
    """A square part of the table around all of its views."""
    places = np.vstack((fingerprint.states[:, :2], fingerprint.centre[:2]))
    low, high = places.min(axis=0), places.max(axis=0)
    half = 0.6 * max(float((high - low).max()), _LEAST_SIDE)
    x, y = (low + high) / 2.0
    return (x - half, x + half, y - half, y + half)
