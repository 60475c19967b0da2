"""Worlds: the objects on the simulated table, read from YAML and checked before anything starts."""

from __future__ import annotations

import logging
import math
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Dict, Optional, Tuple, Union

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.errors import WorldError
from embodied_active_learning.files import FileReader
from embodied_active_learning.schema import load, suggestion
from embodied_active_learning.simulation.assets import check_picture
from embodied_active_learning.simulation.object_model import ObjectModel, read_model
from embodied_active_learning.simulation.placed_objects import PlacedObject, Table
from embodied_active_learning.simulation.placement import check_heights, check_objects, warn_of_unseen
from embodied_active_learning.simulation.resources import locate, worlds_folder
from embodied_active_learning.simulation.world_settings import (
    Disturbances,
    GeneratedTexture,
    Lighting,
    ObjectSettings,
    TableSettings,
    WorldSettings,
)
from embodied_active_learning.workspace import Workspace

_TABLE_MARGIN = 0.25  # m of table around the workspace: more than half the camera's footprint
_MAX_OBJECTS = 200
DEFAULT_TEXTURE = GeneratedTexture("plain", 57)
"""Light grey with faint grain: images of one colour would hold the arm."""

_log = logging.getLogger(__name__)
_SMALL, _LARGE = 0.02, 0.16  # m, of an object's largest extent


@dataclass(frozen=True)
class World:
    """A table with objects, its lighting, and disturbances of camera and arm."""

    name: str
    objects: Tuple[PlacedObject, ...]
    table: Table
    disturbances: Disturbances = field(default_factory=Disturbances)
    lighting: Lighting = field(default_factory=Lighting)


def world_names() -> Tuple[str, ...]:
    """Return the names of the shipped worlds."""
    return tuple(sorted(path.stem for path in worlds_folder().glob("*.yaml")))


def load_world(name_or_path: Union[str, Path], workspace: Workspace, camera: Optional[CameraConfig] = None) -> World:
    """Load a world and everything it refers to.

    Args:
        name_or_path: Name of a shipped world, or path of a YAML file.
        workspace: Workspace around which the table is placed by default.
        camera: If given, objects must stay below it, and a table of one colour is logged as a warning.

    Raises:
        WorldError: The world cannot be built; the message names file, key and remedy.
    """
    path = find_world(name_or_path)
    reader = FileReader(WorldError, f"see the shipped worlds in {worlds_folder()}", follow=True)
    world = build_world(load(WorldSettings, path, reader), workspace, path)
    if camera is not None:
        try:
            check_heights(world.objects, camera)
            warn_of_unseen(world.objects, workspace, camera)
        except WorldError as error:
            raise WorldError(f"{path}: {error}") from error
        _warn_of_plain_table(world, camera)
    return world


def build_world(settings: WorldSettings, workspace: Workspace, path: Path) -> World:
    """Build a world from its settings; path: of its file, for relative paths, its name, and messages."""
    try:
        table = _build_table(settings.table, path.parent, workspace)
        objects = _place_all(settings.objects, path.parent)
        check_objects(objects, table)
    except WorldError as error:
        raise WorldError(f"{path}: {error}") from error
    return World(path.stem, objects, table, settings.disturbances, settings.lighting)


def find_world(name_or_path: Union[str, Path]) -> Path:
    """Return the file of a shipped world by name, or the path itself. Raises WorldError with the nearest known name."""
    name = str(name_or_path)
    if "\0" in name:
        raise WorldError(f"invalid simulation/world {name!r}: give a name or the path of a YAML file")
    path = Path(os.path.expanduser(name))
    if path.suffix in (".yaml", ".yml"):
        return path.absolute()
    known = world_names()
    if name not in known:
        raise WorldError(f"unknown world {name!r}: {suggestion(name, known)}; or give the path of a YAML file")
    return worlds_folder() / f"{name}.yaml"


def _place_all(settings: Dict[str, ObjectSettings], folder: Path) -> Tuple[PlacedObject, ...]:
    """Read each model once, and place all objects."""
    if len(settings) > _MAX_OBJECTS:
        raise WorldError(f"{len(settings)} objects: at most {_MAX_OBJECTS} are supported")
    models: Dict[str, ObjectModel] = {}
    for name, item in settings.items():
        try:
            if item.urdf not in models:
                models[item.urdf] = read_model(locate(item.urdf, folder))
        except WorldError as error:
            raise WorldError(f"objects/{name}/urdf: {error}") from error
    return tuple(_place(name, item, models[item.urdf]) for name, item in settings.items())


def _place(name: str, settings: ObjectSettings, model: ObjectModel) -> PlacedObject:
    if settings.colour is None and not model.has_colour:
        _log.warning("objects/%s is rendered white: %s defines no colour; set colour in the world", name, model.urdf)
    largest, stem = float(model.extent.max()), model.urdf.stem
    if not 0.0 < largest < math.inf:
        raise WorldError(f"objects/{name}: {model.mesh} has an extent of {largest:g} m: check its vertices and scale")
    scale = settings.size / largest if settings.size is not None else settings.scale or 1.0
    if not _SMALL <= scale * largest <= _LARGE:
        _log.warning(
            "objects/%s is %.3g m large: %g to %g m is advised; sizes are in metres",
            name, scale * largest, _SMALL, _LARGE,
        )  # fmt: skip
    return PlacedObject(
        name=name,
        kind=settings.kind or (f"random_{stem}" if stem.isdecimal() else stem.split("_")[0]),
        model=model,
        position=settings.position,
        yaw=settings.yaw,
        scale=scale,
        height=settings.height,
        colour=settings.colour,
    )


def _build_table(settings: TableSettings, folder: Path, workspace: Workspace) -> Table:
    centre = tuple(float(value) for value in workspace.centre[:2])
    size = tuple(float(2.0 * (value + _TABLE_MARGIN)) for value in workspace.scale[:2])
    texture = None if settings.texture is None else locate(settings.texture, folder)
    if texture is not None:
        check_picture(texture)
    generated = settings.generate
    if texture is None and settings.colour is None and generated is None:
        generated = DEFAULT_TEXTURE
    return Table(
        centre=settings.centre or centre,
        size=settings.size or size,
        texture=texture,
        colour=settings.colour or Table.colour,
        generated=generated,
    )


def _warn_of_plain_table(world: World, camera: CameraConfig) -> None:
    plain = world.table.texture is None and world.table.generated is None
    if plain and not world.disturbances.image_noise and not camera.allow_featureless:
        _log.warning(
            "the table of world %s has one colour: images without an object have one colour, and the arm is held; "
            "use `table: {generate: {kind: plain}}`, or set camera/allow_featureless",
            world.name,
        )
