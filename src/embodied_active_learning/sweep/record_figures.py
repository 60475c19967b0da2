"""The learning-metrics figure of records, whose images are rendered from the world file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Dict, Sequence

import numpy as np

from embodied_active_learning.figures.learning_metrics import draw_learning_metrics
from embodied_active_learning.figures.top_view import SessionImages, TopView
from embodied_active_learning.session.observations import Observations
from embodied_active_learning.simulation.scene import Scene
from embodied_active_learning.simulation.world import load_world
from embodied_active_learning.sweep.run_records import Record

_MARGIN = 0.08  # m around the workspace
_WIDTH = 400  # pixels


def draw_record_metrics(path: Path, records: Sequence[Record]) -> Path:
    """Draw a column for each world and explorer, with a line for each seed. Raises WorldError if a world is missing."""
    views: Dict[str, TopView] = {}

    def images(record: Record) -> SessionImages:
        world = record.config.simulation.world
        if world not in views:
            views[world] = render_top_view(record)
        table = record.read_table("exploration")
        states = np.stack([table[name] for name in ("x", "y", "theta")], axis=1)
        return SessionImages(
            Observations(states, states, np.empty((0, 1, 1, 3), np.uint8), table["time"]), views[world]
        )

    return draw_learning_metrics(path, [_with_pdf(record) for record in records], images)


def _with_pdf(record: Record) -> Record:
    """Return a record whose figures are also written as PDF."""
    config = record.config
    return replace(record, config=replace(config, session=replace(config.session, pdf_figures=True)))


def render_top_view(record: Record) -> TopView:
    """Return the world of a record as seen from above."""
    config = record.config
    workspace = config.workspace.box()
    centre, size = workspace.centre[:2], 2.0 * (float(workspace.scale[:2].max()) + _MARGIN)
    scene = Scene(load_world(config.simulation.world, workspace), config.camera)
    pixels = scene.top_view(centre, size, _WIDTH)
    scene.close()
    (x, y), half = centre, size / 2.0
    return TopView(pixels, np.ones(pixels.shape[:2], bool), (x - half, x + half, y - half, y + half))
