"""How all figures look: colours that colour-blind readers can tell apart, quiet axes, one way to the file."""

from __future__ import annotations

import io
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from embodied_active_learning.session.atomic import write_bytes

# Okabe and Ito's palette, in an order in which neighbours differ in lightness too.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MAP_COLOURS = "viridis"
GREY = "#666666"
UNSEEN = "#EDEDED"
SMALL = 8
MEDIUM = 9
_DOTS_PER_INCH = 160


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of a size in inches. Not pyplot's, so that any thread may draw and none leaks."""
    figure = Figure(figsize=(width, height), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.06, h_pad=0.06)
    return figure


def colour(index: int) -> str:
    """The colour of the line number `index`."""
    return COLOURS[index % len(COLOURS)]


def quiet(axes: Axes) -> None:
    """Only the two lines that carry the ticks, and a faint grid."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=SMALL)
    axes.grid(color="#E0E0E0", linewidth=0.5)
    axes.set_axisbelow(True)
    axes.margins(x=0.01)


def label(axes: Axes, x: str = "", y: str = "", title: str = "") -> None:
    """Axis labels with their units, and a title."""
    axes.set_xlabel(x, fontsize=SMALL)
    axes.set_ylabel(y, fontsize=SMALL)
    if title:
        axes.set_title(title, fontsize=MEDIUM)


def save(figure: Figure, path: Path) -> Path:
    """Write the figure as PNG, atomically, creating its folder. -> path."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=_DOTS_PER_INCH)
    write_bytes(path, picture.getvalue())
    return path
