"""The paper's figure of learning metrics: are the latents in use, and does the arm go where the uncertainty is."""

from __future__ import annotations

from pathlib import Path
from typing import Callable, Dict, List, Sequence

import numpy as np
from matplotlib.axes import Axes

from embodied_active_learning.config import SIMULATED
from embodied_active_learning.errors import SessionError
from embodied_active_learning.figures.mosaic import Seen, look_back
from embodied_active_learning.figures.style import GREY, LARGE, SMALL, colour, label, new_figure, quiet, save
from embodied_active_learning.figures.views import draw_path, draw_top_view
from embodied_active_learning.session.session import Session

_HEIGHTS = (1.0, 1.0, 1.0, 1.0, 2.6)


def draw_learning_metrics(path: Path, sessions: Sequence[Session], look: Callable[[Session], Seen] = look_back) -> Path:
    """One column for each world and explorer, its seeds over each other; rows as in the paper, and the loss.

    look: what tells what a session's camera has seen.
    """
    columns = _columns(sessions)
    figure = new_figure(1.0 + 3.2 * len(columns), 9.2)
    grid = figure.subplots(
        len(_HEIGHTS), len(columns), squeeze=False, gridspec_kw={"height_ratios": _HEIGHTS}, sharey="row"
    )
    for index, (title, members) in enumerate(columns.items()):
        axes: List[Axes] = list(grid[:, index])
        axes[0].set_title(title, fontsize=LARGE)
        _draw_active_units(axes[0], members)
        _draw_ergodic_measure(axes[1], members)
        _draw_loss(axes[2], members)
        _draw_weights(axes[3], members)
        _draw_workspace(axes[4], members[0], look(members[0]))
        for later in axes if index else ():
            later.set_ylabel("")
    return save(figure, path)


def _columns(sessions: Sequence[Session]) -> Dict[str, List[Session]]:
    """Sessions by the title of their column: the ergodic ones first, then the baselines."""
    if not sessions:
        raise SessionError("there is nothing to draw: give at least one session")
    columns: Dict[str, List[Session]] = {}
    for session in sorted(sessions, key=lambda one: one.config.exploration.explorer != "ergodic"):
        explorer = session.config.exploration.explorer
        config = session.config
        where = config.simulation.world if config.arm.robot == SIMULATED else config.arm.robot
        world = Path(where).stem.capitalize()
        title = world if explorer == "ergodic" else f"{world}, {explorer.replace('_', ' ')}"
        columns.setdefault(title, []).append(session)
    return columns


def _draw_active_units(axes: Axes, sessions: Sequence[Session]) -> None:
    for index, session in enumerate(sessions):
        table = session.read_table("training")
        axes.plot(table["update"], table["active_units"], color=colour(index), linewidth=1.0, label=_seed(session))
    axes.set_ylim(-0.5, sessions[0].config.model.latent_size + 0.5)
    quiet(axes)
    label(axes, "model update", "active units")
    if len(sessions) > 1:
        axes.legend(fontsize=SMALL, frameon=False, loc="lower right", ncols=min(len(sessions), 3))


def _draw_ergodic_measure(axes: Axes, sessions: Sequence[Session]) -> None:
    for index, session in enumerate(sessions):
        table = session.read_table("exploration")
        axes.plot(table["step"], _positive(table["ergodic_measure"]), color=colour(index), linewidth=0.8)
    axes.set_yscale("log")
    quiet(axes)
    label(axes, "exploration step", "KL-ergodic\nmeasure [nat]")


def _draw_loss(axes: Axes, sessions: Sequence[Session]) -> None:
    for index, session in enumerate(sessions):
        table = session.read_table("training")
        axes.plot(table["update"], _smooth(table["loss"]), color=colour(index), linewidth=1.0)
    quiet(axes)
    label(axes, "model update", "loss per pixel [nat]")


def _draw_weights(axes: Axes, sessions: Sequence[Session]) -> None:
    """Beta and gamma share colours with their seeds, and differ in the dashes."""
    for index, session in enumerate(sessions):
        table = session.read_table("training")
        for name, dashes in (("beta", "-"), ("gamma", (0, (4, 2)))):
            values = _positive(table[name])
            axes.plot(table["update"], values, color=colour(index), linestyle=dashes, linewidth=1.0)
    for name, dashes in ((r"$\beta$", "-"), (r"$\gamma$", (0, (4, 2)))):
        axes.plot([], [], color=GREY, linestyle=dashes, linewidth=1.0, label=name)
    axes.set_yscale("log")
    axes.legend(fontsize=SMALL, frameon=False, loc="center right", ncols=2)
    quiet(axes)
    label(axes, "model update", "weights of\nthe loss")


def _draw_workspace(axes: Axes, session: Session, seen: Seen) -> None:
    """The table as a session saw it, with its path."""
    draw_top_view(axes, seen.table)
    draw_path(axes, seen.observations.raw_states, session.config.workspace.box())


def _seed(session: Session) -> str:
    return f"seed {session.config.exploration.seed}"


def _positive(values: np.ndarray) -> np.ndarray:
    """What a logarithmic axis can show; the rest becomes a gap."""
    return np.where(values > 0, values, np.nan)


def _smooth(values: np.ndarray) -> np.ndarray:
    """Running mean over a hundredth of the values, as long as they are."""
    width = max(1, len(values) // 100)
    if width == 1:
        return values
    sums = np.cumsum(np.insert(values, 0, np.zeros(1)))
    mean = (sums[width:] - sums[:-width]) / width
    return np.concatenate((np.full(width - 1, np.nan), mean))
