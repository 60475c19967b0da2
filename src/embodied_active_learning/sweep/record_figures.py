"""The learning-metrics figure of records, whose images are rendered from the world file."""

from __future__ import annotations

from pathlib import Path
from typing import Dict, Sequence, Tuple

import numpy as np

from embodied_active_learning.figures.learning_metrics import draw_learning_metrics
from embodied_active_learning.figures.top_view import TopView
from embodied_active_learning.simulation.scene import Scene
from embodied_active_learning.simulation.world import load_world
from embodied_active_learning.sweep.run_records import Record

_MARGIN = 0.08  # m around the workspace
_WIDTH = 400  # pixels


def draw_record_metrics(path: Path, records: Sequence[Record]) -> Path:
    """Draw a column for each world and explorer, with a line for each seed. Raises WorldError if a world is missing."""
    views: Dict[str, TopView] = {}

    def camera_path(record: Record) -> Tuple[np.ndarray, TopView]:
        world = record.config.simulation.world
        if world not in views:
            views[world] = render_top_view(record)
        table = record.read_table("exploration")
        return np.stack([table[name] for name in ("x", "y", "theta")], axis=1), views[world]

    return draw_learning_metrics(path, records, camera_path, pdf=True)


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
