"""Panels of shares with intervals."""

from embodied_active_learning.figures.shares import draw_shares


def test_shares_are_drawn_as_png_and_pdf(tmp_path):
    panels = {"hits": {"a": (0.9, 0.8, 1.0), "b": None}, "false claims": {"a": (0.0, 0.0, 0.1), "b": (0.1, 0.0, 0.3)}}
    path = draw_shares(tmp_path / "shares.png", panels, {"hits": 0.95})
    assert path.read_bytes().startswith(b"\x89PNG")
    assert path.with_suffix(".pdf").read_bytes().startswith(b"%PDF")
