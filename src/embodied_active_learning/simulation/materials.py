"""Materials of OBJ meshes: colour and texture of every face, from MTL files."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Dict, List, Optional, Tuple

import numpy as np

from embodied_active_learning.errors import WorldError
from embodied_active_learning.files import short_repr
from embodied_active_learning.simulation.assets import read_asset, read_picture
from embodied_active_learning.simulation.obj_mesh import Mesh, argument

Colour = Tuple[float, float, float]
WHITE: Colour = (1.0, 1.0, 1.0)
_MAX_FILE_SIZE = 2**20
# Number of arguments of the options that may precede the file name of map_Kd.
_OPTIONS = {"-blendu": 1, "-blendv": 1, "-boost": 1, "-bm": 1, "-clamp": 1, "-texres": 1, "-imfchan": 1, "-mm": 2}
_TRANSFORMS = ("-o", "-s", "-t")  # move, scale and distort the texture: up to three numbers


@dataclass(frozen=True)
class MeshAppearance:
    """Look of a mesh: one colour, one colour per face, or a texture."""

    colour: Colour = WHITE
    """RGB in [0, 1]; multiplies a texture."""
    texture: Optional[np.ndarray] = None
    """(H, W, 3) uint8 RGB."""
    face_colours: Optional[np.ndarray] = None
    """(F, 3) RGB in [0, 1]."""


@dataclass(frozen=True)
class _Material:
    colour: Colour = WHITE
    texture: str = ""  # as written in the MTL file


def mesh_appearance(mesh: Mesh) -> MeshAppearance:
    """Return the look that a mesh and its MTL files define.

    Raises WorldError if a file it refers to is missing or unusable, or if it cannot be rendered as defined.
    """
    materials = _read_libraries(mesh)
    used = [_find(materials, name, mesh) for name in mesh.materials]
    textures = {item.texture for item in used}
    if len(textures) > 1:
        listed = ", ".join(sorted(item.texture or "a plain colour" for item in used))
        raise WorldError(f"mesh {mesh.path} has several textures ({listed}): bake them into one texture")
    (texture,) = textures
    if texture:
        return MeshAppearance(texture=texture_of(mesh, _texture_path(texture, mesh.path)))
    face_colours = mesh.face_colours()
    if face_colours is not None:
        return MeshAppearance(face_colours=face_colours)
    colours = [item.colour for item in used]
    if len(set(colours)) == 1:
        return MeshAppearance(colours[0])
    return MeshAppearance(face_colours=np.array(colours)[mesh.face_materials])


def texture_of(mesh: Mesh, path: Path) -> np.ndarray:
    """Read the texture of a mesh. Raises WorldError if it is unusable, or the mesh has no texture coordinates."""
    if not mesh.has_texture_coordinates:
        raise WorldError(f"mesh {mesh.path} has texture {path} but faces without texture coordinates: unwrap it")
    return read_picture(path)


def _read_libraries(mesh: Mesh) -> Dict[str, _Material]:
    materials: Dict[str, _Material] = {}
    for path in missing_libraries(mesh):
        raise WorldError(
            f"mesh {mesh.path}: its material file {path.name} is missing: copy it next to the mesh, or define a "
            "colour in the URDF"
        )
    for library in mesh.libraries:
        for path in _library_paths(library, mesh.path):
            content = read_asset(path, f"the material file of {mesh.path.name}", _MAX_FILE_SIZE)
            _parse(content.decode("utf-8", "replace"), path, materials)
    return materials


def missing_libraries(mesh: Mesh) -> List[Path]:
    """Return the material files of a mesh that do not exist."""
    return [
        path for library in mesh.libraries for path in _library_paths(library, mesh.path) if not os.path.exists(path)
    ]


def _library_paths(library: str, mesh: Path) -> List[Path]:
    """Paths of an mtllib statement: one name, which may contain blanks, or several names."""
    if "\0" in library or not library:
        raise WorldError(f"mesh {mesh}: invalid material file {short_repr(library)}")
    names = [library] if os.path.exists(mesh.parent / library) else library.split()
    return [mesh.parent / name for name in names]


def _parse(text: str, path: Path, materials: Dict[str, _Material]) -> None:
    """Add the materials of an MTL file."""
    name = ""
    for line in text.splitlines():
        keyword, *words = line.split() or [""]
        if keyword == "newmtl":
            name = argument(line)
            materials[name] = _Material()
        elif keyword == "Kd":
            materials[name] = replace(materials.get(name, _Material()), colour=_colour(words, path))
        elif keyword == "map_Kd":
            materials[name] = replace(materials.get(name, _Material()), texture=_texture_name(line, path))


def _colour(words: List[str], path: Path) -> Colour:
    try:
        red, green, blue = (float(word) for word in words)
    except ValueError:
        red = math.nan
    if not math.isfinite(red) or not (math.isfinite(green) and math.isfinite(blue)):
        raise WorldError(
            f"{path}: invalid colour Kd {short_repr(' '.join(words))}: give red, green and blue from 0 to 1"
        )
    return min(max(red, 0.0), 1.0), min(max(green, 0.0), 1.0), min(max(blue, 0.0), 1.0)


def _texture_name(line: str, path: Path) -> str:
    """File name of a map_Kd statement, which may follow options and contain blanks."""
    rest = argument(line)
    while rest.startswith("-"):
        option, _, rest = rest.partition(" ")
        if option in _TRANSFORMS:
            values, rest = _leading_numbers(rest)
            identity = 1.0 if option == "-s" else 0.0
            if any(value != identity for value in values):
                raise WorldError(f"{path}: texture option {option} is not supported: apply it to the texture or mesh")
        elif option in _OPTIONS:
            rest = "".join(rest.split(maxsplit=_OPTIONS[option])[_OPTIONS[option] :])
        else:
            raise WorldError(f"{path}: unknown texture option {short_repr(option)}: remove it from the map_Kd line")
        rest = rest.strip()
    if not rest or "\0" in rest:
        raise WorldError(f"{path}: map_Kd names no texture file: complete or remove the line")
    return rest


def _leading_numbers(text: str) -> Tuple[List[float], str]:
    """Up to three numbers at the beginning of a text, and the rest."""
    values: List[float] = []
    while len(values) < 3:
        word, _, rest = text.strip().partition(" ")
        try:
            values.append(float(word))
        except ValueError:
            break
        text = rest
    return values, text


def _find(materials: Dict[str, _Material], name: Optional[str], mesh: Mesh) -> _Material:
    """The material of a name; white for faces without one, and for meshes without material files."""
    if name is None or (not mesh.libraries and name not in materials):
        return _Material()
    if name not in materials:
        known = ", ".join(sorted(materials)[:8]) or "none"
        raise WorldError(
            f"mesh {mesh.path} uses the material {short_repr(name)}, its material files define {known}: fix it"
        )
    return materials[name]


def _texture_path(name: str, mesh: Path) -> Path:
    path = mesh.parent / name
    if not os.path.exists(path):
        hint = " (a Windows path? use / in it)" if "\\" in name or ":" in name else ""
        raise WorldError(f"mesh {mesh}: its texture {path} is missing{hint}: copy it there, or fix the MTL file")
    return path
