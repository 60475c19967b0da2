"""Evidence of decisions: the learned object, its mask, and what the views show at the decided pose."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import NamedTuple, Sequence

import numpy as np
from matplotlib.axes import Axes

from embodied_active_learning.figures.style import MEDIUM, SMALL, default_style, new_figure, save
from embodied_active_learning.geometry import to_base_frame
from embodied_active_learning.objects.appearance import PIXEL, SIDE, Appearance, pixel_positions
from embodied_active_learning.objects.decision import Decision
from embodied_active_learning.objects.scene_views import SceneViews
from embodied_active_learning.objects.similarity import matches, nearest_stored_views

_ROW_HEIGHT, _WIDTH = 2.4, 9.0  # inches
_DIMMED = 4
"""Factor by which pixels beside the object are darkened."""
_LINES, _LINE_LENGTH = 4, 34
"""Lines of a reason that are shown, and characters in each."""
_EXTENT = 50.0 * SIDE * PIXEL  # half a side in cm
_MATCH = "object (dots), ring around it (crosses)\ngreen: for the object, red: against it"
_COLUMNS = ("learned", "object's pixels", "best place", _MATCH)


class Evidence(NamedTuple):
    """One decision, with the appearance that it was compared with."""

    label: str
    appearance: Appearance
    decision: Decision


@default_style
def draw_evidence(path: Path, rows: Sequence[Evidence], views: SceneViews, pdf: bool = False) -> Path:
    """Draw a row for each decision. Return the path."""
    figure = new_figure(_WIDTH, _ROW_HEIGHT * max(len(rows), 1))
    for row, part in zip(rows, figure.subfigures(max(len(rows), 1), squeeze=False)[:, 0]):
        part.suptitle(f"{row.label}: {row.decision.outcome}", fontsize=MEDIUM)
        grid = list(part.subplots(1, len(_COLUMNS)))
        for title, axes in zip(_COLUMNS, grid):
            axes.set_xticks([])
            axes.set_yticks([])
            axes.set_title(title, fontsize=SMALL)
        _draw_row(row, grid, views)
    return save(figure, path, pdf)


def _draw_row(row: Evidence, axes: Sequence[Axes], views: SceneViews) -> None:
    """Draw one decision."""
    appearance, decision = row.appearance, row.decision
    stored = appearance.central_view if appearance.usable.any() else 0
    picture, mask = appearance.colours[stored], appearance.masks[stored]
    _show(axes[0], picture)
    _show(axes[1], np.where(mask[..., None], picture, picture // _DIMMED))
    if appearance.problem or not decision.views:
        why = "cannot be recognised" if appearance.problem else "no view of the best place"
        for axis in axes[2:]:
            axis.text(0.5, 0.5, why, transform=axis.transAxes, ha="center", va="center", fontsize=SMALL)
        return
    pose = appearance.centre_at(decision.pose)
    view = views.nearest(pose[:2], 1, np.inf)
    (stored,) = nearest_stored_views(appearance, views, view, pose)
    found, _ = views.colours(int(view[0]), to_base_frame(pixel_positions().reshape(-1, 2), pose[None])[0])
    of_object, of_ring = matches(appearance, views, int(view[0]), int(stored), pose)
    for axis in axes[2:]:
        _show(axis, found.reshape(SIDE, SIDE, 3))
    _mark(axes[3], appearance.inside_points[stored], of_object, "o")
    _mark(axes[3], appearance.ring_points[stored], 1.0 - of_ring, "x")
    axes[3].set_xlabel(
        textwrap.fill(decision.reason, _LINE_LENGTH, max_lines=_LINES, placeholder="..."), fontsize=SMALL
    )


def _mark(axes: Axes, points: np.ndarray, values: np.ndarray, marker: str) -> None:
    """Mark points (N, 2) [m] from red, where a value (N,) is 0, to green, where it is 1."""
    x, y = 100.0 * points.T
    axes.scatter(x, y, s=6, c=values, marker=marker, vmin=0.0, vmax=1.0, cmap="RdYlGn", linewidths=0.6)


def _show(axes: Axes, picture: np.ndarray) -> None:
    """Show a rectified view (SIDE, SIDE, 3) in cm around the fingerprint's centre."""
    axes.imshow(picture, origin="lower", extent=(-_EXTENT, _EXTENT, -_EXTENT, _EXTENT))
