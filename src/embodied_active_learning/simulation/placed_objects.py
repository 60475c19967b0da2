"""Objects that stand on a table."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Optional, Tuple

import numpy as np

from embodied_active_learning.simulation.materials import MeshAppearance
from embodied_active_learning.simulation.object_model import ObjectModel
from embodied_active_learning.simulation.world_settings import GeneratedTexture


@dataclass(frozen=True)
class PlacedObject:
    """A model on the table; position is that of the centre of its mesh."""

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
        """(3,) size of the box around the mesh at yaw 0, m."""
        return self.scale * self.model.extent

    @property
    def rgb(self) -> Tuple[float, ...]:
        """Red, green, blue in [0, 1] of the object, or of its texture's tint."""
        return tuple((self.model.colour if self.colour is None else self.colour)[:3])

    @property
    def appearance(self) -> MeshAppearance:
        """Look of the mesh; a colour of the world file replaces colours of its faces."""
        model = self.model.appearance
        return model if self.colour is None else replace(model, face_colours=None)

    def corners(self) -> np.ndarray:
        """(4, 2) corners of the rotated box around the mesh, m, in the base frame."""
        signs = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        cosine, sine = math.cos(self.yaw), math.sin(self.yaw)
        rotation = np.array([[cosine, -sine], [sine, cosine]])
        return signs * self.extent[:2] / 2.0 @ rotation.T + self.position


@dataclass(frozen=True)
class Table:
    """The table top, at z = 0: a picture, a generated texture, or one colour."""

    centre: Tuple[float, ...]
    size: Tuple[float, ...]
    texture: Optional[Path] = None
    colour: Tuple[float, ...] = (0.82, 0.80, 0.77)
    generated: Optional[GeneratedTexture] = None

    def contains(self, points: np.ndarray) -> bool:
        """Return whether all points (N, 2), m, lie on the table."""
        return bool(np.all(np.abs(points - np.asarray(self.centre)) <= np.asarray(self.size) / 2.0))
