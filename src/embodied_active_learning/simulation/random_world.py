"""Random worlds: objects at random places on a generated table, for evaluation."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np
import yaml

from embodied_active_learning.errors import WorldError
from embodied_active_learning.schema import to_plain
from embodied_active_learning.simulation.object_model import read_model
from embodied_active_learning.simulation.resources import locate
from embodied_active_learning.simulation.table_textures import TEXTURE_KINDS
from embodied_active_learning.simulation.world_settings import (
    GeneratedTexture,
    Lighting,
    ObjectSettings,
    TableSettings,
    WorldSettings,
)
from embodied_active_learning.workspace import Workspace

SHIPPED = ("duck", "plant", "star")
"""Kinds of the objects in worlds/models."""
RANDOM_URDFS = 1000
"""Number of procedural objects in pybullet_data, random_urdfs/000 to /999."""
_EDGE = 0.03  # m, least distance of an object's centre from the edge of the workspace
_SIZES = (0.06, 0.09)  # m, largest side of a procedural object
_MIN_WIDTH = 0.5  # least width and depth of a procedural object, relative to its largest side
_MAX_ATTEMPTS = 60  # of placing all objects


def random_world(
    seed: int,
    count: int = 3,
    spacing: float = 0.1,
    distractors: int = 0,
    kinds: Sequence[str] = SHIPPED,
    table: Optional[GeneratedTexture] = None,
    lighting: bool = False,
) -> WorldSettings:
    """Return the settings of a random world in the default workspace; the same for the same arguments.

    Args:
        seed: Seed of everything random.
        count: Number of objects, drawn from `kinds` with repetition.
        spacing: Least distance between the centres of two objects, m.
        distractors: Number of further objects: procedural ones that are not in `kinds`.
        kinds: Shipped kinds (duck, plant, star) and procedural objects (random_urdfs/000 to /999).
        table: Texture of the table; default: a random one.
        lighting: Whether brightness, gradient, shadow and white balance are random; default: neutral.

    Raises:
        WorldError: No kind or an unknown one, or no room for the objects at this spacing.
    """
    if not kinds:
        raise WorldError("kinds is empty: give at least one kind of object")
    generator, workspace = np.random.default_rng(seed), Workspace()
    positions = _positions(count + distractors, spacing, workspace, generator)
    chosen = [kinds[generator.integers(len(kinds))] for _ in range(count)]
    chosen += _distractors(distractors, kinds, generator)
    objects: Dict[str, ObjectSettings] = {}
    for index, (kind, position) in enumerate(zip(chosen, positions)):
        role = "object" if index < count else "distractor"
        objects[f"{role}_{index + 1}"] = _object(kind, position, generator)
    if table is None:
        kind = TEXTURE_KINDS[generator.integers(len(TEXTURE_KINDS))]
        table = GeneratedTexture(kind, int(generator.integers(2**31)))
    light = _lighting(workspace, generator) if lighting else Lighting()
    return WorldSettings(table=TableSettings(generate=table), objects=objects, lighting=light)


def write_world(settings: WorldSettings, path: Path, comment: str = "") -> None:
    """Write settings as a world file, without values that are not set. Raises WorldError if it exists."""
    plain = {name: _without_none(section) for name, section in to_plain(settings).items()}
    text = yaml.safe_dump(plain, sort_keys=False)
    try:
        with path.open("x", encoding="utf-8") as stream:
            stream.write(f"# {comment}\n{text}" if comment else text)
    except OSError as error:
        raise WorldError(f"cannot write {path}: {error.strerror}; choose another path") from error


def _without_none(values: object) -> object:
    if not isinstance(values, dict):
        return values
    return {name: _without_none(value) for name, value in values.items() if value is not None}


def _object(kind: str, position: Tuple[float, float], generator: np.random.Generator) -> ObjectSettings:
    yaw = round(float(generator.uniform(-math.pi, math.pi)), 3)
    if kind in SHIPPED:
        urdf = f"package://embodied_active_learning/worlds/models/{kind}/{kind}.urdf"
        return ObjectSettings(urdf, position, yaw, scale=0.85 if kind == "duck" else None, kind=kind)
    if not kind.startswith("random_urdfs/"):
        raise WorldError(f"unknown kind {kind!r}: use {', '.join(SHIPPED)}, or random_urdfs/000 to /999")
    return ObjectSettings(kind, position, yaw, size=round(float(generator.uniform(*_SIZES)), 3))


def _distractors(count: int, kinds: Sequence[str], generator: np.random.Generator) -> List[str]:
    """Names of different procedural objects that are wide enough to be seen from above."""
    found: List[str] = []
    untried = {f"random_urdfs/{number:03d}" for number in range(RANDOM_URDFS)} - set(kinds)
    while len(found) < count:
        if not untried:
            raise WorldError(
                f"only {len(found)} of {count} procedural objects are left: use fewer kinds or distractors"
            )
        name = f"random_urdfs/{generator.integers(RANDOM_URDFS):03d}"
        if name in untried and is_wide(name):
            found.append(name)
        untried.discard(name)
    return found


def is_wide(name: str) -> bool:
    """Return whether a procedural object is at least half as wide and deep as its largest side, and usable."""
    try:
        extent = read_model(locate(name, Path())).extent
    except WorldError:  # one of them has no finite coordinates
        return False
    return bool(extent[:2].min() >= _MIN_WIDTH * extent.max())


def _positions(
    count: int, spacing: float, workspace: Workspace, generator: np.random.Generator
) -> List[Tuple[float, float]]:
    """Random positions (x, y), m, that keep their distance."""
    lower, upper = np.array(workspace.lower[:2]) + _EDGE, np.array(workspace.upper[:2]) - _EDGE
    if not count:
        return []
    attempts = _MAX_ATTEMPTS if (lower < upper).all() else 0
    for _ in range(attempts):
        points: List[np.ndarray] = []
        for _ in range(20 * count):
            point = np.round(generator.uniform(lower, upper), 3)
            if all(np.hypot(*(point - other)) >= spacing for other in points):
                points.append(point)
            if len(points) == count:
                return [(float(x), float(y)) for x, y in points]
    raise WorldError(f"no room for {count} objects {spacing:g} m apart in the workspace: use fewer, or less spacing")


def _lighting(workspace: Workspace, generator: np.random.Generator) -> Lighting:
    """Lighting as it varies between rooms and hours."""
    centre = generator.uniform(workspace.lower[:2], workspace.upper[:2])
    return Lighting(
        brightness=round(float(generator.uniform(0.75, 1.2)), 3),
        gradient=round(float(generator.uniform(0.0, 1.0)), 3),
        gradient_direction=round(float(generator.uniform(-math.pi, math.pi)), 3),
        shadow=round(float(generator.uniform(0.0, 0.35)), 3),
        shadow_centre=tuple(np.round(centre, 3).tolist()),
        shadow_radius=round(float(generator.uniform(0.05, 0.12)), 3),
        white_balance=tuple(np.round(generator.uniform(0.93, 1.07, 3), 3).tolist()),
    )
