"""How all figures look: colours that colour-blind readers can tell apart, quiet axes, one way to the file."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from embodied_active_learning.session.atomic import make_folder, write_bytes

# Okabe and Ito's palette, in an order in which neighbours differ in lightness too.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MAP_COLOURS = "viridis"
GREY = "#666666"
UNSEEN = "#EDEDED"
SMALL = 8
MEDIUM = 9
LARGE = 11
_DOTS_PER_INCH = 160
_COMPRESSION = 4  # of 9: a twentieth larger than by the usual 6, in half the time


def new_figure(width: float, height: float, arranged: bool = True) -> Figure:
    """An empty figure of a size in inches. Not pyplot's, so that any thread may draw and none leaks.

    arranged: matplotlib finds the places of all axes; else they stay where they are put.
    """
    if not arranged:
        return Figure(figsize=(width, height))
    figure = Figure(figsize=(width, height), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.06, h_pad=0.06)
    return figure


def place(figure: Figure, left: float, top: float, width: float, height: float) -> Axes:
    """New axes in a figure that is not arranged, inches from its upper left corner; a picture stays in theirs."""
    wide, high = figure.get_size_inches()
    axes = figure.add_axes((left / wide, 1.0 - (top + height) / high, width / wide, height / high))
    axes.set_anchor("NW")
    return axes


def write(figure: Figure, left: float, top: float, text: str, size: float, weight: str = "normal") -> None:
    """Write into a figure that is not arranged, downwards from a place in inches from its upper left corner."""
    wide, high = figure.get_size_inches()
    figure.text(left / wide, 1.0 - top / high, text, fontsize=size, weight=weight, va="top")


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


def spread(count: int, most: int) -> np.ndarray:
    """At most so many of the indices below count, evenly spread."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int)) if count else np.empty(0, int)


def save(figure: Figure, path: Path) -> Path:
    """Write the figure as PNG, atomically, creating its folder. -> path."""
    path = Path(path)
    make_folder(path.parent)
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=_DOTS_PER_INCH, pil_kwargs={"compress_level": _COMPRESSION})
    write_bytes(path, picture.getvalue())
    return path
