"""Panels of curves."""

import numpy as np

from embodied_active_learning.figures.curves import Curve, draw_curves
from embodied_active_learning.figures.style import SMALL, new_figure, style_axes


def test_curves_are_drawn_as_png_and_pdf(tmp_path):
    x = np.linspace(1.0, 10.0, 5)
    curves = [Curve("a", x, x, 0.9 * x, 1.1 * x), Curve("b", x, x**3, np.full(5, np.nan), np.full(5, np.nan))]
    path = draw_curves(
        tmp_path / "curves.png", {"error": curves, "empty": []}, {"error": "step", "empty": "step"}, "title"
    )
    assert path.read_bytes().startswith(b"\x89PNG")
    assert path.with_suffix(".pdf").read_bytes().startswith(b"%PDF")


def test_figure_without_panels_is_empty(tmp_path):
    assert draw_curves(tmp_path / "curves.png", {}, {}).read_bytes().startswith(b"\x89PNG")


def test_minor_ticks_of_log_axis_have_small_labels():
    """Below one decade there may be no other labels."""
    axes = new_figure(2.0, 1.0).subplots()
    axes.plot([0.2, 0.9])
    axes.set_yscale("log")
    style_axes(axes)
    axes.figure.canvas.draw()
    assert {text.get_size() for text in axes.get_yminorticklabels() if text.get_text()} == {SMALL}
