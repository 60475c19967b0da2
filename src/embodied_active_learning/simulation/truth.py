"""What really stands on a simulated table: for pictures and tables, never for what the system decides."""

from __future__ import annotations

from typing import Dict, List, Sequence, Tuple

from embodied_active_learning.config import SIMULATED, Config
from embodied_active_learning.errors import WorldError
from embodied_active_learning.geometry import Location
from embodied_active_learning.objects.fingerprint import FingerprintSet
from embodied_active_learning.objects.report import true_kinds
from embodied_active_learning.simulation.world import load_world


def true_objects(config: Config) -> List[Location]:
    """The objects of the configured world; none where there is no such world, or the table is not simulated."""
    if config.arm.robot != SIMULATED:
        return []
    try:
        world = load_world(config.simulation.world, config.workspace.box())
    except WorldError:
        return []
    return [(item.kind, float(item.position[0]), float(item.position[1])) for item in world.objects]


def fingerprint_kinds(sets: Sequence[FingerprintSet]) -> Dict[Tuple[str, str], str]:
    """What each (session, fingerprint) is really of, by the worlds that the sessions have learned: see true_kinds."""
    return {
        (found.session, name): kind
        for found in sets
        for name, kind in true_kinds(found, true_objects(found.config)).items()
    }
