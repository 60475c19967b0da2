"""The shape of an object as its URDF describes it: one textured OBJ mesh, and the box around it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Tuple
from xml.etree import ElementTree as ET

import numpy as np

from embodied_active_learning.errors import WorldError
from embodied_active_learning.files import FileReader, shown
from embodied_active_learning.geometry import fixed_axes_rotation
from embodied_active_learning.simulation.resources import locate

_URDF_READER = FileReader(WorldError, "give the URDF of an object", limit=2**20, follow=True)
_MESH_READER = FileReader(WorldError, "give an OBJ mesh", limit=2**28, follow=True)
Vector = Tuple[float, ...]


@dataclass(frozen=True)
class ObjectModel:
    """A mesh in its link frame, and the box around it there."""

    urdf: Path
    mesh: Path
    mesh_scale: Vector
    mesh_position: Vector
    mesh_rpy: Vector
    colour: Vector
    lower: Vector
    upper: Vector

    @property
    def centre(self) -> np.ndarray:
        """(3,) centre of the box around the mesh, m, in the link frame."""
        return (np.asarray(self.lower) + np.asarray(self.upper)) / 2.0

    @property
    def extent(self) -> np.ndarray:
        """(3,) size of the box around the mesh, m."""
        return np.asarray(self.upper) - np.asarray(self.lower)


def read_model(urdf: Path) -> ObjectModel:
    """The one visual mesh of an object's URDF. Raises WorldError naming the file and what it lacks."""
    visual = _only_visual(urdf)
    mesh_element = visual.find("geometry/mesh")
    if mesh_element is None:
        raise WorldError(f"{urdf}: its visual is not a mesh; give an OBJ mesh")
    mesh = locate(mesh_element.get("filename", ""), urdf.parent)
    scale = _vector(urdf, mesh_element.get("scale", "1 1 1"), 3)
    position, rpy = _origin(urdf, visual)
    vertices = _vertices(urdf, mesh) * scale @ fixed_axes_rotation(rpy).T + position
    return ObjectModel(
        urdf=urdf,
        mesh=mesh,
        mesh_scale=scale,
        mesh_position=position,
        mesh_rpy=rpy,
        colour=_colour(urdf, visual),
        lower=tuple(vertices.min(axis=0)),
        upper=tuple(vertices.max(axis=0)),
    )


def _only_visual(urdf: Path) -> ET.Element:
    content = _URDF_READER.read_bytes(urdf)
    try:
        # A world's models are as trusted as the world file that names them.
        robot = ET.fromstring(content)  # noqa: S314
    except (ET.ParseError, LookupError, ValueError) as error:  # the latter two for encodings that it does not know
        raise WorldError(f"URDF {urdf} is not XML: {error}") from error
    visuals = list(robot.iter("visual"))
    if len(visuals) != 1:
        raise WorldError(f"URDF {urdf} has {len(visuals)} visuals: an object is one link with one visual mesh")
    return visuals[0]


def _vertices(urdf: Path, mesh: Path) -> np.ndarray:
    """(V, 3) vertices of an OBJ file, in its own units."""
    if mesh.suffix.lower() != ".obj":
        raise WorldError(f"{urdf}: mesh {mesh.name} is not an OBJ file")
    try:
        lines = _MESH_READER.read_bytes(mesh).decode("utf-8", "replace").splitlines()
    except WorldError as error:
        raise WorldError(f"{urdf}: its mesh cannot be used: {error}") from error
    try:
        vertices = np.array([line.split()[1:4] for line in lines if line.startswith("v ")], dtype=np.float64)
    except ValueError as error:
        raise WorldError(f"{urdf}: mesh {mesh} is damaged: {error}") from error
    if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.isfinite(vertices).all():
        raise WorldError(f"{urdf}: mesh {mesh} has no usable vertices")
    return vertices


def _origin(urdf: Path, visual: ET.Element) -> Tuple[Vector, Vector]:
    origin = visual.find("origin")
    keys = {} if origin is None else origin.attrib
    return _vector(urdf, keys.get("xyz", "0 0 0"), 3), _vector(urdf, keys.get("rpy", "0 0 0"), 3)


def _colour(urdf: Path, visual: ET.Element) -> Vector:
    colour = visual.find("material/color")
    return _vector(urdf, "1 1 1 1" if colour is None else colour.get("rgba", ""), 4)


def _vector(urdf: Path, text: str, size: int) -> Vector:
    try:
        numbers = tuple(float(part) for part in text.split())
    except ValueError:
        numbers = ()
    if len(numbers) != size or not np.isfinite(numbers).all():
        raise WorldError(f"{urdf}: {shown(text)} is not {size} numbers")
    return numbers
