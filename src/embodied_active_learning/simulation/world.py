"""What stands on the table, from worlds/*.yaml; everything is checked before anything starts."""

from __future__ import annotations

import difflib
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Optional, Tuple

import numpy as np

from embodied_active_learning.errors import WorldError
from embodied_active_learning.simulation.object_model import ObjectModel, read_model
from embodied_active_learning.simulation.resources import locate, worlds_folder
from embodied_active_learning.simulation.section import Section
from embodied_active_learning.workspace import Workspace

_TABLE_MARGIN = 0.25  # m of table around the workspace: more than half the camera's footprint


@dataclass(frozen=True)
class PlacedObject:
    """A model on the table; position is where the centre of its mesh comes to lie."""

    name: str
    kind: str
    model: ObjectModel
    position: Tuple[float, ...]
    yaw: float = 0.0
    scale: float = 1.0
    height: float = 0.0
    colour: Optional[Tuple[float, ...]] = None

    @property
    def extent(self) -> np.ndarray:
        """(3,) size of the box around the unturned mesh, m."""
        return self.scale * self.model.extent

    def corners(self) -> np.ndarray:
        """(4, 2) corners of the turned box around the mesh, m, in the base frame."""
        signs = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        cosine, sine = math.cos(self.yaw), math.sin(self.yaw)
        turn = np.array([[cosine, -sine], [sine, cosine]])
        return signs * self.extent[:2] / 2.0 @ turn.T + self.position


@dataclass(frozen=True)
class Table:
    """The table top, at z = 0: one texture stretched over it, or a plain colour."""

    centre: Tuple[float, ...]
    size: Tuple[float, ...]
    texture: Optional[Path] = None
    colour: Tuple[float, ...] = (0.82, 0.80, 0.77)

    def contains(self, points: np.ndarray) -> bool:
        """Whether all points (N, 2), m, lie on the table."""
        return bool(np.all(np.abs(points - np.asarray(self.centre)) <= np.asarray(self.size) / 2.0))


@dataclass(frozen=True)
class Disturbances:
    """Standard deviations of what a real robot adds; all zero in a clean simulation."""

    image_noise: float = 0.0  # grey levels, each pixel and image anew
    brightness_drift: float = 0.0  # part of the brightness, slowly varying
    actuation_noise: Tuple[float, ...] = (0.0, 0.0, 0.0)  # m/s, m/s, rad/s, each command anew


@dataclass(frozen=True)
class World:
    """One workspace: its objects, the table under them, and what disturbs."""

    name: str
    objects: Tuple[PlacedObject, ...]
    table: Table
    disturbances: Disturbances = Disturbances()


def world_names() -> Tuple[str, ...]:
    """Names of the shipped worlds."""
    return tuple(sorted(path.stem for path in worlds_folder().glob("*.yaml")))


def load_world(name_or_path: str, workspace: Workspace) -> World:
    """A shipped world by name, or any by the path of its YAML file. Raises WorldError for whatever cannot be built."""
    path = find_world(name_or_path)
    top = Section.read(path, ("table", "objects", "disturbances"))
    table = _table(top.section("table", ("centre", "size", "texture", "colour")), path.parent, workspace)
    named = top.section("objects")
    objects = tuple(_placed(named, name, path.parent) for name in named)
    for item in objects:
        if not table.contains(item.corners()):
            raise WorldError(
                f"{named.where}/{item.name} at {list(item.position)} does not stand on the table, which is "
                f"{list(table.size)} m around {list(table.centre)}: move it, or enlarge table/size"
            )
    disturbances = _disturbances(top.section("disturbances", Disturbances.__dataclass_fields__))
    return World(name=path.stem, objects=objects, table=table, disturbances=disturbances)


def find_world(name_or_path: str) -> Path:
    """The file of a shipped world by name, or the path itself. Raises WorldError with the nearest known name."""
    path = Path(os.path.expanduser(name_or_path))
    if "\0" in name_or_path:
        raise WorldError(f"simulation/world is {name_or_path!r}, and no such file can be: give another one")
    if path.suffix in (".yaml", ".yml"):
        return path.absolute()
    known = world_names()
    if name_or_path not in known:
        nearest = difflib.get_close_matches(name_or_path, known, n=1)
        hint = f"did you mean {nearest[0]}? " if nearest else ""
        raise WorldError(
            f"unknown world {name_or_path!r}: {hint}There are {', '.join(known)}; or give the path of a YAML file"
        )
    return worlds_folder() / f"{name_or_path}.yaml"


def _placed(objects: Section, name: str, folder: Path) -> PlacedObject:
    known = ("urdf", "kind", "position", "yaw", "scale", "height", "colour")
    keys = objects.section(name, known)
    model = read_model(locate(keys.text("urdf"), folder))
    return PlacedObject(
        name=name,
        kind=keys.text("kind", model.urdf.stem.split("_")[0]),
        model=model,
        position=keys.numbers("position", (2,)),
        yaw=keys.number("yaw", 0.0),
        scale=keys.number("scale", 1.0, low=1e-3, high=1e3),
        height=keys.number("height", 0.0, low=0.0),
        colour=keys.numbers("colour", (3, 4), low=0.0, high=1.0) if "colour" in keys else None,
    )


def _table(keys: Section, folder: Path, workspace: Workspace) -> Table:
    centre = tuple(float(value) for value in workspace.centre[:2])
    size = tuple(float(2.0 * (value + _TABLE_MARGIN)) for value in workspace.scale[:2])
    texture = locate(keys.text("texture"), folder) if "texture" in keys else None
    if texture is not None and not os.path.exists(texture):
        raise WorldError(f"{keys.where}/texture: there is no file {texture}")
    return Table(
        centre=keys.numbers("centre", (2,), default=centre),
        size=keys.numbers("size", (2,), default=size, low=0.01),
        texture=texture,
        colour=keys.numbers("colour", (3,), default=Table.colour, low=0.0, high=1.0),
    )


def _disturbances(keys: Section) -> Disturbances:
    return Disturbances(
        image_noise=keys.number("image_noise", 0.0, low=0.0, high=255.0),
        brightness_drift=keys.number("brightness_drift", 0.0, low=0.0, high=1.0),
        actuation_noise=keys.numbers("actuation_noise", (3,), default=(0.0, 0.0, 0.0), low=0.0),
    )
