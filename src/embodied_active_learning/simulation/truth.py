"""What really stands on the simulated table: for pictures and tables, never for what the system decides."""

from __future__ import annotations

from typing import List, Tuple

from embodied_active_learning.config import Config
from embodied_active_learning.errors import WorldError
from embodied_active_learning.simulation.world import load_world

Location = Tuple[str, float, float]  # kind of object, x [m], y [m]


def true_objects(config: Config) -> List[Location]:
    """The objects of the configured world; none where there is no such world."""
    try:
        world = load_world(config.simulation.world, config.workspace.box())
    except WorldError:
        return []
    return [(item.kind, float(item.position[0]), float(item.position[1])) for item in world.objects]
