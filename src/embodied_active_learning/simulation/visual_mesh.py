"""Write the files from which the renderer loads an object: one mesh with one colour or one texture."""

from __future__ import annotations

from pathlib import Path
from typing import Tuple

import cv2
import numpy as np

from embodied_active_learning.simulation.materials import MeshAppearance
from embodied_active_learning.simulation.obj_mesh import Mesh

_SWATCH = 4  # pixels


def write_visual(mesh: Mesh, appearance: MeshAppearance, path: Path) -> None:
    """Write OBJ, MTL and texture of a mesh. The look's colour is left to the renderer."""
    texture = path.with_suffix(".png")
    if appearance.texture is not None:
        _write_picture(texture, appearance.texture)
        mesh.write(path, texture.name)
    elif appearance.face_colours is not None:
        picture, coordinates = _palette(appearance.face_colours)
        _write_picture(texture, picture)
        mesh.write(path, texture.name, coordinates)
    else:
        mesh.write(path)


def _palette(colours: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Return a picture of swatches for face colours (F, 3) in [0, 1], and texture coordinates (F, 2) of the faces."""
    swatches, index = np.unique(np.rint(255.0 * colours).astype(np.uint8), axis=0, return_inverse=True)
    side = int(np.ceil(np.sqrt(len(swatches))))
    cells: np.ndarray = np.zeros((side * side, 3), np.uint8)
    cells[: len(swatches)] = swatches
    picture = cells.reshape(side, side, 3).repeat(_SWATCH, axis=0).repeat(_SWATCH, axis=1)
    row, column = np.divmod(index.reshape(-1), side)
    return picture, np.stack([(column + 0.5) / side, 1.0 - (row + 0.5) / side], axis=1)


def _write_picture(path: Path, picture: np.ndarray) -> None:
    cv2.imwrite(str(path), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
