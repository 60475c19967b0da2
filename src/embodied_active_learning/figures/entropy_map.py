"""Maps of the conditional entropy over the workspace, with the visited states and the table from above."""

from __future__ import annotations

from pathlib import Path
from typing import Sequence

import numpy as np
from matplotlib.axes import Axes

from embodied_active_learning.figures.style import (
    MEDIUM,
    SMALL,
    colour,
    default_style,
    new_figure,
    save,
)
from embodied_active_learning.figures.top_view import SessionImages
from embodied_active_learning.figures.workspace_axes import (
    draw_map,
    draw_top_view,
    extent_of,
    mark_objects,
    show_workspace,
)
from embodied_active_learning.model.trained_model import TrainedModel
from embodied_active_learning.objects.scoring import TrueObject
from embodied_active_learning.session.observations import Observations
from embodied_active_learning.session.session import Session
from embodied_active_learning.subsampling import spread_indices
from embodied_active_learning.workspace import Workspace

_GRID = 48  # cells in x and in y
_YAWS = 7  # cells in yaw
_LATENTS = 8  # latents that the entropy is averaged over
_SHOWN_YAWS = (1, 3, 5)  # cells in yaw that get their own map


@default_style
def draw_entropy(
    path: Path,
    session: Session,
    model: TrainedModel,
    images: SessionImages,
    objects: Sequence[TrueObject] = (),
    pdf: bool = False,
) -> Path:
    """Draw the mean map, visited states and the table from above; below, maps at three yaws. One colour scale."""
    workspace = session.config.workspace.box()
    maps = entropy_maps(model, _latents(model, images.observations), workspace)
    extent, limits = extent_of(workspace), (float(maps.min()), float(maps.max()))
    figure = new_figure(9.2, 6.0)
    axes = figure.subplots(2, 3)
    image = draw_map(axes[0, 0], maps.mean(axis=0), extent, limits)
    axes[0, 0].set_title("mean over yaw", fontsize=MEDIUM)
    _draw_visited(axes[0, 1], images.observations.raw_states, workspace)
    draw_top_view(axes[0, 2], images.table)
    show_workspace(axes[0, 2], workspace)
    axes[0, 2].set_title("camera images", fontsize=MEDIUM)
    yaws = workspace.centre[2] + workspace.scale[2] * _centres(_YAWS)
    for shown, index in zip(axes[1], _SHOWN_YAWS):
        draw_map(shown, maps[index], extent, limits)
        shown.set_title(f"yaw {yaws[index]:+.2f} rad", fontsize=MEDIUM)
    for shown in (axes[0, 0], axes[0, 2], *axes[1]):
        mark_objects(shown, objects)
    bar = figure.colorbar(image, ax=axes, shrink=0.6, pad=0.02)
    bar.set_label(r"conditional entropy: mean ln $\sigma$ of a grey level in [0, 1]", fontsize=SMALL)
    bar.ax.tick_params(labelsize=SMALL)
    return save(figure, path, pdf)


def entropy_maps(model: TrainedModel, latents: np.ndarray, workspace: Workspace) -> np.ndarray:
    """Return mean ln sigma over latents (N, L) at the centres of the cells: (yaws, ny, nx), y upwards."""
    yaw, y, x = np.meshgrid(_centres(_YAWS), _centres(_GRID), _centres(_GRID), indexing="ij")
    states = workspace.denormalise(np.stack((x, y, yaw), axis=-1).reshape(-1, 3))
    return model.log_std(latents, states).mean(axis=0).reshape(_YAWS, _GRID, _GRID)


def _draw_visited(axes: Axes, states: np.ndarray, workspace: Workspace) -> None:
    """Draw the visited states (N, 3)."""
    axes.scatter(states[:, 0], states[:, 1], s=5, color=colour(0), alpha=0.5, linewidths=0)
    show_workspace(axes, workspace)
    axes.set_title(f"{len(states)} visited states", fontsize=MEDIUM)


def _centres(cells: int) -> np.ndarray:
    """Centres (cells,) of equal cells between -1 and 1."""
    return (np.arange(cells) + 0.5) / cells * 2.0 - 1.0


def _latents(model: TrainedModel, observations: Observations) -> np.ndarray:
    """Mean latents (N, L) of observations spread over the run."""
    indices = spread_indices(len(observations.stamps), _LATENTS)
    means, _ = model.encode(observations.raw_states[indices], observations.images[indices])
    return means
