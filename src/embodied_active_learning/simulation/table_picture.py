"""Images of the empty table, as seen by the wrist camera."""

from __future__ import annotations

import cv2
import numpy as np

from embodied_active_learning.simulation.assets import read_picture
from embodied_active_learning.simulation.placed_objects import Table
from embodied_active_learning.simulation.table_textures import generate_texture

_FLOOR = (96, 94, 92)  # grey levels beyond the table's edge


class TablePicture:
    """The table top seen from straight above.

    A plane seen head-on is its texture moved, rotated and scaled. This is faster than the renderer, which also samples
    textures without filtering.
    """

    def __init__(self, table: Table) -> None:
        """Read or generate the texture. Raises WorldError for an unusable file."""
        self._texture = _texture(table)
        rows, columns = self._texture.shape[:2]
        width, depth = table.size
        left, top = table.centre[0] - width / 2.0, table.centre[1] + depth / 2.0
        scale_x, scale_y = columns / width, rows / depth
        # Base frame (x, y, 1) in m -> texture pixel; the first pixel's centre is half a pixel from the table's edge.
        self._to_texture = np.array(
            [[scale_x, 0.0, -scale_x * left - 0.5], [0.0, -scale_y, scale_y * top - 0.5], [0.0, 0.0, 1.0]]
        )

    def picture(self, camera: np.ndarray, matrix: np.ndarray, columns: int, rows: int) -> np.ndarray:
        """Return (rows, columns, 3) uint8 for a camera pose (4, 4) looking straight down, and its matrix K (3, 3)."""
        to_plane = np.eye(3)
        to_plane[:2, :2] = camera[:2, :2] * camera[2, 3]
        to_plane[:2, 2] = camera[:2, 3]
        pixel_to_texture = self._to_texture @ to_plane @ np.linalg.inv(matrix)
        return cv2.warpAffine(
            self._texture,
            pixel_to_texture[:2],
            (columns, rows),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=_FLOOR,
        )


def _texture(table: Table) -> np.ndarray:
    """(H, W, 3) uint8 RGB of the table top."""
    if table.texture is not None:
        return read_picture(table.texture)
    if table.generated is not None:
        return generate_texture(table.generated.kind, table.generated.seed)
    return np.full((2, 2, 3), np.rint(255.0 * np.asarray(table.colour)), dtype=np.uint8)
