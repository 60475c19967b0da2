"""Where the model is uncertain: its conditional entropy over the workspace, beside what it has seen."""

from __future__ import annotations

from pathlib import Path
from typing import Sequence

import numpy as np
import torch
from matplotlib.axes import Axes

from embodied_active_learning.figures.mosaic import top_view
from embodied_active_learning.figures.network import encode, mean_log_std
from embodied_active_learning.figures.style import MEDIUM, SMALL, colour, new_figure, save
from embodied_active_learning.figures.views import Location, draw_map, draw_top_view, mark_objects, show_workspace
from embodied_active_learning.model.cvae import ConditionalVAE
from embodied_active_learning.session.observations import Observations
from embodied_active_learning.session.session import Session
from embodied_active_learning.workspace import Workspace

_GRID = 48  # cells along each side
_YAWS = 7
_LATENTS = 8
_SHOWN_YAWS = (1, 3, 5)  # of the seven, from the lowest to the highest


def draw_entropy(
    path: Path, session: Session, network: ConditionalVAE, seen: Observations, objects: Sequence[Location] = ()
) -> Path:
    """Top: mean map, visited states, table from above. Bottom: the map at three yaws. One colour scale for all."""
    workspace = session.config.workspace.box()
    maps = entropy_maps(network, _latents(network, seen))
    limits = (float(maps.min()), float(maps.max()))
    figure = new_figure(9.2, 6.0)
    axes = figure.subplots(2, 3)
    image = draw_map(axes[0, 0], maps.mean(axis=0), workspace, limits)
    axes[0, 0].set_title("mean over yaw", fontsize=MEDIUM)
    _draw_visited(axes[0, 1], seen.raw_states, workspace)
    draw_top_view(axes[0, 2], top_view(seen.images, seen.raw_states, session.config.camera, workspace))
    show_workspace(axes[0, 2], workspace)
    axes[0, 2].set_title("what the camera saw", fontsize=MEDIUM)
    for shown, index in zip(axes[1], _SHOWN_YAWS):
        yaw = workspace.denormalise(np.array([0.0, 0.0, _yaws()[index]]))[2]
        draw_map(shown, maps[index], workspace, limits)
        shown.set_title(f"yaw {yaw:+.2f} rad", fontsize=MEDIUM)
    for shown in (axes[0, 0], axes[0, 2], *axes[1]):
        mark_objects(shown, objects)
    bar = figure.colorbar(image, ax=axes, shrink=0.6, pad=0.02)
    bar.set_label(r"conditional entropy: mean ln $\sigma$ of a grey level in [0, 1]", fontsize=SMALL)
    bar.ax.tick_params(labelsize=SMALL)
    return save(figure, path)


def entropy_maps(network: ConditionalVAE, latents: torch.Tensor) -> np.ndarray:
    """Mean ln sigma over latents (N, L). -> (yaws, ny, nx); x and y at the middle of the cells, y upwards."""
    middles = (np.arange(_GRID) + 0.5) / _GRID * 2.0 - 1.0
    yaw, y, x = np.meshgrid(_yaws(), middles, middles, indexing="ij")
    states = np.stack((x, y, yaw), axis=-1).reshape(-1, 3)
    return mean_log_std(network, latents, states).reshape(_YAWS, _GRID, _GRID)


def _draw_visited(axes: Axes, states: np.ndarray, workspace: Workspace) -> None:
    axes.scatter(states[:, 0], states[:, 1], s=5, color=colour(0), alpha=0.5, linewidths=0)
    show_workspace(axes, workspace)
    axes.set_title(f"{len(states)} visited states", fontsize=MEDIUM)


def _yaws() -> np.ndarray:
    return (np.arange(_YAWS) + 0.5) / _YAWS * 2.0 - 1.0


def _latents(network: ConditionalVAE, seen: Observations) -> torch.Tensor:
    """Latents of observations spread over the run. -> (N, L)."""
    indices = np.unique(np.linspace(0, len(seen.stamps) - 1, _LATENTS).astype(int))
    return encode(network, seen.states[indices], seen.images[indices])
