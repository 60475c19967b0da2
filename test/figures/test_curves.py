"""Panels of curves."""

import numpy as np

from embodied_active_learning.figures.curves import Curve, draw_curves


def test_curves_are_drawn_as_png_and_pdf(tmp_path):
    x = np.linspace(1.0, 10.0, 5)
    curves = [Curve("a", x, x, 0.9 * x, 1.1 * x), Curve("b", x, x**3, np.full(5, np.nan), np.full(5, np.nan))]
    path = draw_curves(
        tmp_path / "curves.png", {"error": curves, "empty": []}, {"error": "step", "empty": "step"}, "title"
    )
    assert path.read_bytes().startswith(b"\x89PNG")
    assert path.with_suffix(".pdf").read_bytes().startswith(b"%PDF")
