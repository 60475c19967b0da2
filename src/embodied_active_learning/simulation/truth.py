"""The true scene of a simulation, for figures and tables only; decisions never use it."""

from __future__ import annotations

from typing import Dict, List, Optional, Sequence, Tuple

from embodied_active_learning.config import SIMULATED, Config
from embodied_active_learning.errors import WorldError
from embodied_active_learning.objects.fingerprint import FingerprintSet
from embodied_active_learning.objects.scoring import TrueObject, Truth, true_kinds
from embodied_active_learning.simulation.world import World, load_world


def true_objects(config: Config) -> List[TrueObject]:
    """Return the objects of the configured world, for measurements; none on hardware.

    Raises:
        WorldError: The world's file cannot be loaded.
    """
    if config.arm.robot != SIMULATED:
        return []
    world = load_world(config.simulation.world, config.workspace.box())
    return objects_of(world)


def objects_of(world: World) -> List[TrueObject]:
    """Return the objects of a world."""
    return [TrueObject(item.name, item.kind, *map(float, item.position[:2])) for item in world.objects]


def true_scene(config: Config, sets: Sequence[FingerprintSet] = ()) -> Truth:
    """Return the true objects of the configured world, and the true kinds of fingerprints, to show beside results.

    Nothing is known on hardware, or if the world's file cannot be loaded.
    """
    objects = _known_objects(config)
    if objects is None:
        return Truth()
    kinds: Dict[Tuple[str, str], str] = {}
    for item in sets:
        learned_from = _known_objects(item.config)
        if learned_from is not None:
            kinds.update({(item.session, name): kind for name, kind in true_kinds(item, learned_from).items()})
    return Truth(objects, kinds)


def _known_objects(config: Config) -> Optional[List[TrueObject]]:
    """Objects of the configured world, or None if they are not known."""
    if config.arm.robot != SIMULATED:
        return None
    try:
        return true_objects(config)
    except WorldError:
        return None
