"""The table as the wrist camera sees it, without what stands on it."""

from __future__ import annotations

import cv2
import numpy as np

from embodied_active_learning.errors import WorldError
from embodied_active_learning.files import FileReader
from embodied_active_learning.simulation.world import Table

_READER = FileReader(WorldError, "give a PNG or JPEG file", limit=2**28, follow=True)
_FLOOR = (96, 94, 92)  # grey levels beyond the table's edge


class TablePicture:
    """The table top seen from straight above.

    Nothing on the table lies behind it, and a plane seen head-on is its texture moved, turned and scaled: so it need
    not go through the renderer, which would spend most of its time on it and sample the texture without filtering.
    """

    def __init__(self, table: Table) -> None:
        """Read the texture. Raises WorldError for a file that is no image."""
        self._texture = _texture(table)
        rows, columns = self._texture.shape[:2]
        width, depth = table.size
        left, top = table.centre[0] - width / 2.0, table.centre[1] + depth / 2.0
        scale_x, scale_y = columns / width, rows / depth
        # Base frame (x, y, 1) in m -> texture pixel, whose first centre lies half a pixel from the table's edge.
        self._to_texture = np.array(
            [[scale_x, 0.0, -scale_x * left - 0.5], [0.0, -scale_y, scale_y * top - 0.5], [0.0, 0.0, 1.0]]
        )

    def picture(self, camera: np.ndarray, matrix: np.ndarray, columns: int, rows: int) -> np.ndarray:
        """(rows, columns, 3) uint8 for a camera pose (4, 4) that looks straight down, and its K (3, 3)."""
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
    if table.texture is None:
        return np.full((2, 2, 3), np.rint(255.0 * np.asarray(table.colour)), dtype=np.uint8)
    content = np.frombuffer(_READER.read_bytes(table.texture), np.uint8)
    try:
        image = cv2.imdecode(content, cv2.IMREAD_COLOR)
    except cv2.error:  # it is empty, or more pixels than OpenCV takes
        image = None
    if image is None:
        raise _READER.refuse(f"texture {table.texture}", "is not an image")
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
