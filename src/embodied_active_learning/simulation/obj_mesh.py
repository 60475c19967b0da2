"""Read and write OBJ meshes: everything is validated here, so that the renderer only reads files written by us."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np

from embodied_active_learning.errors import WorldError
from embodied_active_learning.files import short_repr
from embodied_active_learning.simulation.assets import read_asset

_MAX_FILE_SIZE = 2**27
_MAX_COORDINATE = 1e30  # the renderer has single precision


@dataclass(frozen=True)
class Mesh:
    """An OBJ mesh. Coordinates keep their text, so that the renderer reads exactly the numbers of the file."""

    path: Path
    vertices: np.ndarray
    """(V, 3) coordinates."""
    corners: np.ndarray
    """(C, 3) indices of vertex, texture coordinate and normal of each corner, from 0; -1 for none."""
    starts: np.ndarray
    """(F + 1,) first corner of each face, and the number of corners."""
    materials: Tuple[Optional[str], ...]
    """Names of the materials in use; None for faces without one."""
    face_materials: np.ndarray
    """(F,) index into materials of each face."""
    libraries: Tuple[str, ...]
    """Arguments of the mtllib statements."""
    vertex_colours: Optional[np.ndarray]
    """(V, 3) in [0, 1], an extension some scanners write; None without."""
    text: Tuple[List[str], List[str], List[str]]
    """Arguments of the v, vt and vn statements."""

    @property
    def used_vertices(self) -> np.ndarray:
        """(U, 3) coordinates of the vertices that belong to a face."""
        return self.vertices[np.unique(self.corners[:, 0])]

    @property
    def has_texture_coordinates(self) -> bool:
        """Whether every corner has texture coordinates."""
        return bool(np.all(self.corners[:, 1] >= 0))

    def triangles(self) -> np.ndarray:
        """(T, 3, 3) coordinates of the triangles, polygons split into fans."""
        counts = np.diff(self.starts)
        first = np.repeat(self.starts[:-1], counts - 2)
        offset = np.arange(len(first)) - np.repeat(np.cumsum(counts - 2) - (counts - 2), counts - 2)
        corners = np.stack([first, first + offset + 1, first + offset + 2], axis=1)
        return self.vertices[self.corners[corners, 0]]

    def face_colours(self) -> Optional[np.ndarray]:
        """(F, 3) mean vertex colour of each face; None without vertex colours."""
        if self.vertex_colours is None:
            return None
        sums = np.add.reduceat(self.vertex_colours[self.corners[:, 0]], self.starts[:-1])
        return sums / np.diff(self.starts)[:, None]

    def write(self, path: Path, texture: str = "", palette: Optional[np.ndarray] = None) -> None:
        """Write OBJ and MTL files for the renderer.

        Args:
            path: The OBJ file; the MTL file is written next to it.
            texture: Name of the texture file; empty for none.
            palette: (F, 2) texture coordinates of each face; replaces those of the mesh.
        """
        vertices, coordinates, normals = self.text
        corners = self.corners + 1
        if palette is not None:
            coordinates = [f"{u:.6f} {v:.6f}" for u, v in palette]
            corners[:, 1] = np.repeat(np.arange(1, len(palette) + 1), np.diff(self.starts))
        lines = [f"mtllib {path.stem}.mtl", "usemtl material"]
        lines += [f"v {item}" for item in vertices]
        lines += [f"vt {item}" for item in coordinates]
        lines += [f"vn {item}" for item in normals]
        words = _corner_words(corners)
        lines += [f"f {' '.join(words[a:b])}" for a, b in zip(self.starts[:-1].tolist(), self.starts[1:].tolist())]
        path.write_text("\n".join([*lines, ""]), encoding="ascii")
        map_line = f"map_Kd {texture}\n" if texture else ""
        path.with_suffix(".mtl").write_text(f"newmtl material\nKd 1 1 1\n{map_line}", encoding="ascii")


def read_mesh(path: Path) -> Mesh:
    """Read an OBJ file. Raises WorldError if it is unreadable, malformed, or has no faces."""
    if path.suffix.lower() != ".obj":
        raise WorldError(f"mesh {path} is not an OBJ file: convert it to OBJ")
    content = read_asset(path, "an OBJ mesh", _MAX_FILE_SIZE).decode("utf-8", "replace")
    parser = _Parser()
    for number, line in enumerate(content.replace("\\\r\n", " ").replace("\\\n", " ").splitlines(), 1):
        try:
            parser.parse(line)
        except (ValueError, IndexError) as error:
            raise WorldError(f"mesh {path} is malformed: line {number}, {short_repr(line)}: {error}") from None
    return parser.mesh(path)


@dataclass
class _Parser:
    """Collects the statements of an OBJ file."""

    points: List[str] = field(default_factory=list)
    coordinates: List[str] = field(default_factory=list)
    normals: List[str] = field(default_factory=list)
    colours: List[Tuple[float, ...]] = field(default_factory=list)
    corners: List[Tuple[int, int, int]] = field(default_factory=list)
    starts: List[int] = field(default_factory=lambda: [0])
    materials: Dict[Optional[str], int] = field(default_factory=lambda: {None: 0})
    face_materials: List[int] = field(default_factory=list)
    libraries: List[str] = field(default_factory=list)
    material: int = 0

    def parse(self, line: str) -> None:
        keyword, *words = line.split() or [""]
        if keyword == "v":
            self._add_vertex(words)
        elif keyword == "vt":
            self.coordinates.append(_joined([*words, "0"], 2))
        elif keyword == "vn":
            self.normals.append(_joined(words, 3))
        elif keyword == "f":
            self._add_face(words)
        elif keyword == "usemtl":
            self._use_material(argument(line))
        elif keyword == "mtllib":
            self.libraries.append(argument(line))

    def mesh(self, path: Path) -> Mesh:
        if not self.points:
            raise WorldError(f"mesh {path} has no vertices: export it again as OBJ")
        if not self.face_materials:
            raise WorldError(f"mesh {path} has no faces, only {len(self.points)} vertices: export it with faces")
        _numbers(self.coordinates, "texture coordinate", path)
        _numbers(self.normals, "normal", path)
        used = sorted(set(self.face_materials))
        new_index = {old: new for new, old in enumerate(used)}
        names = list(self.materials)
        return Mesh(
            path=path,
            vertices=_numbers(self.points, "vertex", path).reshape(-1, 3),
            corners=self._checked_corners(path),
            starts=np.array(self.starts),
            materials=tuple(names[index] for index in used),
            face_materials=np.array([new_index[index] for index in self.face_materials]),
            libraries=tuple(self.libraries),
            vertex_colours=np.array(self.colours) if len(self.colours) == len(self.points) else None,
            text=(self.points, self.coordinates, self.normals),
        )

    def _checked_corners(self, path: Path) -> np.ndarray:
        """(C, 3) indices, which may refer to lines further down, after a check of their range."""
        corners = np.array(self.corners)
        lists = (("vertices", self.points), ("texture coordinates", self.coordinates), ("normals", self.normals))
        for column, (name, items) in enumerate(lists):
            largest = int(corners[:, column].max())
            if largest >= len(items):
                raise WorldError(
                    f"mesh {path} is malformed: a face refers to number {largest + 1} of {len(items)} {name}; export "
                    "it again"
                )
        return corners

    def _add_vertex(self, words: Sequence[str]) -> None:
        self.points.append(_joined(words, 3))
        if len(words) == 6:
            colour = tuple(map(float, words[3:]))
            scale = 255.0 if max(colour) > 1.0 else 1.0
            self.colours.append(tuple(min(max(part / scale, 0.0), 1.0) for part in colour))

    def _add_face(self, words: Sequence[str]) -> None:
        if len(words) < 3:
            return  # a degenerate face covers nothing
        totals = len(self.points), len(self.coordinates), len(self.normals)
        self.corners += [_corner(word, totals) for word in words]
        self.starts.append(len(self.corners))
        self.face_materials.append(self.material)

    def _use_material(self, name: str) -> None:
        self.material = self.materials.setdefault(name, len(self.materials))


def argument(line: str) -> str:
    """Return the rest of a statement after its keyword; names may contain blanks."""
    return "".join(line.split(maxsplit=1)[1:]).strip()


def _joined(words: Sequence[str], count: int) -> str:
    """The first numbers of a statement, as text."""
    if len(words) < count:
        raise ValueError(f"expected {count} numbers")
    return " ".join(words[:count])


def _numbers(lines: Sequence[str], name: str, path: Path) -> np.ndarray:
    """The numbers of all statements of a kind, flat. Raises WorldError unless they are finite."""
    text = " ".join(lines)
    try:
        if not text.isascii() or "_" in text:  # which Python accepts in numbers
            raise ValueError("not a plain number")
        values: np.ndarray = np.array(text.split(), dtype=np.float64)
    except ValueError as error:
        raise WorldError(f"mesh {path} is malformed: a {name} is invalid: {error}; export it again") from None
    if not np.all(np.abs(values) < _MAX_COORDINATE):  # also false for NaN
        raise WorldError(f"mesh {path} is malformed: a {name} is not finite; export it again")
    return values


def _corner_words(corners: np.ndarray) -> List[str]:
    """Corners (C, 3), from 1 with 0 for none, as OBJ text."""
    if not corners[:, 1:].any():
        return list(map(str, corners[:, 0].tolist()))
    return ["/".join(str(index or "") for index in corner).rstrip("/") for corner in corners.tolist()]


def _corner(word: str, totals: Tuple[int, int, int]) -> Tuple[int, int, int]:
    """Indices of a corner v, v/t, v//n or v/t/n, from 0; -1 for none."""
    if "/" not in word:
        return _index(word, totals[0]), -1, -1
    parts = word.split("/")
    if len(parts) > 3:
        raise ValueError(f"{word} has more than three indices")
    vertex = _index(parts[0], totals[0])
    texture = _index(parts[1], totals[1]) if len(parts) > 1 and parts[1] else -1
    normal = _index(parts[2], totals[2]) if len(parts) > 2 and parts[2] else -1
    return vertex, texture, normal


def _index(text: str, total: int) -> int:
    """A positive or relative (negative) index, from 0."""
    number = int(text)
    index = number - 1 if number > 0 else total + number
    if number == 0 or not 0 <= index < 2**31:
        raise ValueError(f"index {number} is out of range, there are {total} so far")
    return index
