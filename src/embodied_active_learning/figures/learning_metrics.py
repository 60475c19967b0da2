"""Learning metrics over a run, as in the paper: active units, ergodic measure, loss, loss weights and path."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any, Callable, Dict, List, Protocol, Sequence, Tuple

import numpy as np
from matplotlib.axes import Axes

from embodied_active_learning.config import SIMULATED, Config
from embodied_active_learning.errors import SessionError
from embodied_active_learning.figures.style import (
    GREY,
    LARGE,
    SMALL,
    colour,
    default_style,
    label,
    new_figure,
    save,
    style_axes,
)
from embodied_active_learning.figures.top_view import TopView
from embodied_active_learning.figures.workspace_axes import draw_path, draw_top_view

_COLUMN_WIDTH, _LABEL_WIDTH, _ROW_HEIGHT = 3.2, 1.0, 9.2 / 6.6  # inches, of a row of height 1
_TITLE_WIDTH = 40  # characters

_Row = Tuple[float, Callable[[Axes, Sequence["MeasuredRun"]], None]]
"""Relative height of a row, and what draws it for the runs of a column."""


class MeasuredRun(Protocol):
    """A run with tables: a session, or what is kept of one."""

    @property
    def config(self) -> Config:
        """Configuration of the run."""

    def read_table(self, name: str) -> Dict[str, np.ndarray]:
        """Return the columns (N,) of a table, see Session.read_table."""


@default_style
def draw_learning_metrics(
    path: Path,
    sessions: Sequence[MeasuredRun],
    load_path: Callable[[Any], Tuple[np.ndarray, TopView]],
    pdf: bool = False,
) -> Path:
    """Draw a column per world and explorer, with a line per seed; the title of a single session has its name.

    Args:
        path: Where to write the figure.
        sessions: The runs.
        load_path: Returns the camera states (N, 3) [m, m, rad] of a run and its table seen from above.
        pdf: Whether to write the figure as PDF too.

    Returns:
        The path.

    Raises:
        SessionError: If there are no runs.
    """

    def draw_workspace(axes: Axes, members: Sequence[MeasuredRun]) -> None:
        _draw_workspace(axes, members[0], *load_path(members[0]))

    rows: Sequence[_Row] = (
        (1.0, _draw_active_units),
        (1.0, _draw_ergodic_measure),
        (1.0, _draw_loss),
        (1.0, _draw_weights),
        (2.6, draw_workspace),
    )
    columns, heights = _columns(sessions), [height for height, _ in rows]
    figure = new_figure(_LABEL_WIDTH + _COLUMN_WIDTH * len(columns), _ROW_HEIGHT * sum(heights))
    grid = figure.subplots(len(rows), len(columns), squeeze=False, gridspec_kw={"height_ratios": heights}, sharey="row")
    for index, (title, members) in enumerate(columns.items()):
        grid[0, index].set_title(title, fontsize=LARGE)
        for axes, (_, draw) in zip(grid[:, index], rows):
            draw(axes, members)
            if index:
                axes.set_ylabel("")
    return save(figure, path, pdf)


def _columns(sessions: Sequence[MeasuredRun]) -> Dict[str, List[MeasuredRun]]:
    """Group sessions by the title of their column: the ergodic explorer first, then baselines."""
    if not sessions:
        raise SessionError("no session to draw: give at least one session")
    columns: Dict[str, List[MeasuredRun]] = {}
    for session in sorted(sessions, key=lambda one: one.config.exploration.explorer != "ergodic"):
        explorer = session.config.exploration.explorer
        config = session.config
        where = config.simulation.world if config.arm.robot == SIMULATED else config.arm.robot
        world = Path(where).stem
        title = world if explorer == "ergodic" else f"{world}, {explorer.replace('_', ' ')}"
        if len(sessions) == 1:
            title = f"{textwrap.fill(config.session.name, _TITLE_WIDTH)}\n{title}, {_seed(session)}"
        columns.setdefault(title, []).append(session)
    return columns


def _draw_active_units(axes: Axes, sessions: Sequence[MeasuredRun]) -> None:
    """Number of active latents."""
    for index, session in enumerate(sessions):
        table = session.read_table("training")
        axes.plot(table["update"], table["active_units"], color=colour(index), linewidth=1.0, label=_seed(session))
    axes.set_ylim(-0.5, sessions[0].config.model.latent_size + 0.5)
    style_axes(axes)
    label(axes, "model update", "active units")
    if len(sessions) > 1:
        axes.legend(fontsize=SMALL, frameon=False, loc="lower right", ncols=min(len(sessions), 3))


def _draw_ergodic_measure(axes: Axes, sessions: Sequence[MeasuredRun]) -> None:
    """KL divergence between target and time-averaged distribution."""
    for index, session in enumerate(sessions):
        table = session.read_table("exploration")
        axes.plot(table["step"], _positive(table["ergodic_measure"]), color=colour(index), linewidth=0.8)
    axes.set_yscale("log")
    style_axes(axes)
    label(axes, "exploration step", "KL-ergodic\nmeasure [nat]")


def _draw_loss(axes: Axes, sessions: Sequence[MeasuredRun]) -> None:
    """Smoothed loss."""
    for index, session in enumerate(sessions):
        table = session.read_table("training")
        axes.plot(table["update"], _smooth(table["loss"]), color=colour(index), linewidth=1.0)
    style_axes(axes)
    label(axes, "model update", "loss per pixel [nat]")


def _draw_weights(axes: Axes, sessions: Sequence[MeasuredRun]) -> None:
    """Beta (solid) and gamma (dashed), in the colours of the seeds."""
    for index, session in enumerate(sessions):
        table = session.read_table("training")
        for name, dashes in (("beta", "-"), ("gamma", (0, (4, 2)))):
            values = _positive(table[name])
            axes.plot(table["update"], values, color=colour(index), linestyle=dashes, linewidth=1.0)
    for name, dashes in ((r"$\beta$", "-"), (r"$\gamma$", (0, (4, 2)))):
        axes.plot([], [], color=GREY, linestyle=dashes, linewidth=1.0, label=name)
    axes.set_yscale("log")
    axes.legend(fontsize=SMALL, frameon=False, loc="center right", ncols=2)
    style_axes(axes)
    label(axes, "model update", "weights of\nthe loss")


def _draw_workspace(axes: Axes, session: MeasuredRun, states: np.ndarray, table: TopView) -> None:
    """Table from above and path of the camera, through states (N, 3)."""
    draw_top_view(axes, table)
    every_step = bool(np.all(np.diff(session.read_table("exploration")["step"]) == 1))
    draw_path(axes, states, session.config.workspace.box(), joined=every_step)


def _seed(session: MeasuredRun) -> str:
    """Label of a line."""
    return f"seed {session.config.exploration.seed}"


def _positive(values: np.ndarray) -> np.ndarray:
    """Replace values that a logarithmic axis cannot show by gaps."""
    return np.where(values > 0, values, np.nan)


def _smooth(values: np.ndarray) -> np.ndarray:
    """Running mean over a hundredth of the values, of the same length."""
    width = max(1, len(values) // 100)
    if width == 1:
        return values
    sums = np.cumsum(np.insert(values, 0, np.zeros(1)))
    mean = (sums[width:] - sums[:-width]) / width
    return np.concatenate((np.full(width - 1, np.nan), mean))
