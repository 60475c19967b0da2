"""The workspace as a picture with axes: the table, the path over it, the objects on it."""

from __future__ import annotations

from typing import Sequence, Tuple

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from matplotlib.patches import Rectangle

from embodied_active_learning.figures.mosaic import TopView
from embodied_active_learning.figures.style import MAP_COLOURS, MEDIUM, SMALL, UNSEEN, label, quiet
from embodied_active_learning.workspace import Workspace

Location = Tuple[str, float, float]  # name, x [m], y [m]


def draw_top_view(axes: Axes, view: TopView) -> None:
    """The table from above."""
    axes.set_facecolor(UNSEEN)
    pixels = np.dstack((view.pixels, np.where(view.seen, 255, 0).astype(np.uint8)))
    axes.imshow(pixels, extent=view.extent, origin="upper", interpolation="antialiased")
    _name_axes(axes)


def draw_path(axes: Axes, states: np.ndarray, workspace: Workspace) -> None:
    """The travelled path (N, 3) in m, m, rad, and the limits of the workspace."""
    axes.plot(states[:, 0], states[:, 1], color="black", linewidth=0.4, alpha=0.3)
    (x, y), (right, top) = workspace.lower[:2], workspace.upper[:2]
    axes.add_patch(Rectangle((x, y), right - x, top - y, fill=False, linestyle=(0, (4, 3)), linewidth=0.8))


def draw_map(axes: Axes, values: np.ndarray, workspace: Workspace, limits: Tuple[float, float]) -> AxesImage:
    """Values (ny, nx) over the workspace, the first row at the lowest y. -> the picture, for a colour bar."""
    extent = (workspace.lower[0], workspace.upper[0], workspace.lower[1], workspace.upper[1])
    low, high = limits
    picture = axes.imshow(
        values, extent=extent, origin="lower", cmap=MAP_COLOURS, vmin=low, vmax=high, interpolation="bilinear"
    )
    _name_axes(axes)
    return picture


def mark_objects(axes: Axes, objects: Sequence[Location]) -> None:
    """Where the objects really are."""
    outline = [patheffects.withStroke(linewidth=2.5, foreground="black")]
    for name, x, y in objects:
        axes.plot(x, y, "+", color="white", markersize=9, markeredgewidth=1.4, path_effects=outline)
        axes.annotate(
            name,
            (x, y),
            xytext=(5, 5),
            textcoords="offset points",
            color="white",
            fontsize=MEDIUM,
            path_effects=outline,
            annotation_clip=True,
        )


def show_workspace(axes: Axes, workspace: Workspace) -> None:
    """Let the axes end where the workspace does."""
    axes.set_xlim(workspace.lower[0], workspace.upper[0])
    axes.set_ylim(workspace.lower[1], workspace.upper[1])
    _name_axes(axes)


def _name_axes(axes: Axes) -> None:
    quiet(axes)
    axes.grid(visible=False)
    axes.set_aspect("equal")
    axes.locator_params(nbins=5)
    axes.tick_params(labelsize=SMALL)
    label(axes, "x [m]", "y [m]")
