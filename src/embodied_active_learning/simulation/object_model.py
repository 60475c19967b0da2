"""Object models: one OBJ mesh in a URDF, its size, and its look."""

from __future__ import annotations

import logging
import os
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Optional, Tuple
from xml.etree import ElementTree as ET

import numpy as np

from embodied_active_learning.errors import WorldError
from embodied_active_learning.files import short_repr
from embodied_active_learning.geometry import fixed_axes_rotation
from embodied_active_learning.simulation.assets import read_asset
from embodied_active_learning.simulation.materials import MeshAppearance, mesh_appearance, missing_libraries, texture_of
from embodied_active_learning.simulation.obj_mesh import Mesh, read_mesh
from embodied_active_learning.simulation.resources import locate

_MAX_FILE_SIZE = 2**20
Vector = Tuple[float, ...]

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ObjectModel:
    """A mesh in its link frame, with its bounding box there and its look."""

    urdf: Path
    mesh: Path
    mesh_scale: Vector
    mesh_position: Vector
    mesh_rpy: Vector
    lower: Vector
    upper: Vector
    colour: Vector
    """RGB in [0, 1] of the URDF or MTL file; multiplies a texture."""
    has_colour: bool
    """Whether its files define a colour or texture; white otherwise."""
    shape: Mesh = field(repr=False, compare=False)
    appearance: MeshAppearance = field(repr=False, compare=False)

    @property
    def centre(self) -> np.ndarray:
        """(3,) centre of the bounding box, m, in the link frame."""
        return (np.asarray(self.lower) + np.asarray(self.upper)) / 2.0

    @property
    def extent(self) -> np.ndarray:
        """(3,) size of the bounding box, m."""
        return np.asarray(self.upper) - np.asarray(self.lower)

    @property
    def visible_area(self) -> float:
        """Area (m^2) of the faces that point upwards, seen from above; the renderer does not draw others."""
        corners = self._to_link(self.shape.triangles())
        edges = corners[:, 1:, :2] - corners[:, :1, :2]
        areas = (edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]) / 2.0
        return float(areas[areas > 0.0].sum())

    def _to_link(self, points: np.ndarray) -> np.ndarray:
        """Mesh coordinates (..., 3) in the link frame, m."""
        return points * self.mesh_scale @ fixed_axes_rotation(self.mesh_rpy).T + self.mesh_position


def read_model(urdf: Path) -> ObjectModel:
    """Read a URDF with one visual mesh. Raises WorldError with the file and its problem."""
    robot = _parse(urdf)
    visuals = list(robot.iter("visual"))
    if len(visuals) != 1:
        raise WorldError(f"URDF {urdf} has {len(visuals)} visuals: an object is one link with one visual mesh")
    (visual,) = visuals
    element = visual.find("geometry/mesh")
    if element is None:
        raise WorldError(f"URDF {urdf}: its visual is not a mesh: use an OBJ mesh")
    path = _locate(urdf, element.get("filename", ""))
    scale = _vector(urdf, element.get("scale", "1 1 1"), 3)
    position, rpy = _origin(urdf, visual)
    try:
        mesh = read_mesh(path)
        appearance = _appearance(urdf, robot, visual, mesh)
    except WorldError as error:
        raise WorldError(f"URDF {urdf}: {error}") from error
    vertices = mesh.used_vertices * scale @ fixed_axes_rotation(rpy).T + position
    return ObjectModel(
        urdf=urdf,
        mesh=path,
        mesh_scale=scale,
        mesh_position=position,
        mesh_rpy=rpy,
        lower=tuple(vertices.min(axis=0).tolist()),
        upper=tuple(vertices.max(axis=0).tolist()),
        colour=appearance.colour,
        has_colour=visual.find("material") is not None or bool(mesh.libraries) or mesh.vertex_colours is not None,
        shape=mesh,
        appearance=appearance,
    )


def _parse(urdf: Path) -> ET.Element:
    content = read_asset(urdf, "the URDF of an object", _MAX_FILE_SIZE)
    if b"\0" in content or b"<!DOCTYPE" in content.upper():
        raise WorldError(f"URDF {urdf} is not UTF-8 XML without a DOCTYPE: save it so")  # no entity expansion
    try:
        return ET.fromstring(content)  # noqa: S314  without a DOCTYPE there are no entities to expand
    except (ET.ParseError, LookupError, ValueError) as error:  # the latter two for unknown encodings
        raise WorldError(f"URDF {urdf} is not XML: {error}") from error


def _appearance(urdf: Path, robot: ET.Element, visual: ET.Element, mesh: Mesh) -> MeshAppearance:
    """The URDF's material if it has one, else the mesh's. A URDF colour multiplies the texture of the mesh."""
    colour, texture = _urdf_material(urdf, robot, visual)
    if texture is not None:
        return MeshAppearance(colour or (1.0, 1.0, 1.0), texture=texture_of(mesh, texture))
    if colour is None:
        return mesh_appearance(mesh)
    missing = missing_libraries(mesh)
    if missing:
        _log.warning("%s: material file %s is missing: using the colour of the URDF", urdf, missing[0])
        return MeshAppearance(colour)
    return replace(mesh_appearance(mesh), colour=colour, face_colours=None)


def _urdf_material(
    urdf: Path, robot: ET.Element, visual: ET.Element
) -> Tuple[Optional[Tuple[float, float, float]], Optional[Path]]:
    """Colour and texture of the visual's material, which may be defined at the top of the URDF under its name."""
    material = visual.find("material")
    if material is None:
        return None, None
    if material.find("color") is None and material.find("texture") is None:
        name = material.get("name", "")
        named = [item for item in robot.findall("material") if item.get("name", "") == name]
        if not named:
            raise WorldError(f"material {short_repr(name)} is not defined: add its color or texture")
        material = named[0]
    colour, texture = material.find("color"), material.find("texture")
    if colour is None and texture is None:
        raise WorldError(f"material {short_repr(material.get('name', ''))} has neither color nor texture: add one")
    path = None if texture is None else _locate(urdf, texture.get("filename", ""))
    return (None if colour is None else _colour(urdf, colour.get("rgba", ""))), path


def _colour(urdf: Path, text: str) -> Tuple[float, float, float]:
    red, green, blue, opacity = _vector(urdf, text, 4)
    if not all(0.0 <= value <= 1.0 for value in (red, green, blue, opacity)):
        raise WorldError(f"rgba {short_repr(text)} is out of range: give values from 0 to 1")
    if opacity == 0.0:
        raise WorldError(f"rgba {short_repr(text)} is invisible: set its opacity, the fourth value, to 1")
    return red, green, blue


def _locate(urdf: Path, address: str) -> Path:
    if not address or "\0" in address:
        raise WorldError(f"URDF {urdf}: invalid file name {short_repr(address)}")
    path = locate(address, urdf.parent)
    if "\\" in address and not os.path.exists(path):
        raise WorldError(f"URDF {urdf}: {path} is missing (a Windows path?): use / in file names")
    return path


def _origin(urdf: Path, visual: ET.Element) -> Tuple[Vector, Vector]:
    origin = visual.find("origin")
    keys = {} if origin is None else origin.attrib
    return _vector(urdf, keys.get("xyz", "0 0 0"), 3), _vector(urdf, keys.get("rpy", "0 0 0"), 3)


def _vector(urdf: Path, text: str, size: int) -> Vector:
    try:
        numbers = tuple(float(part) for part in text.split())
    except ValueError:
        numbers = ()
    if len(numbers) != size or not np.isfinite(numbers).all():
        raise WorldError(f"URDF {urdf}: {short_repr(text)} is not {size} numbers")
    return numbers
