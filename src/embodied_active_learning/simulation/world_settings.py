"""What a world file may contain: checked dataclasses with units and legal values."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Dict, Optional, Tuple

from embodied_active_learning.schema import required, setting
from embodied_active_learning.simulation.table_textures import TEXTURE_KINDS

_FULL_TURN = round(2.0 * math.pi, 5) + 1e-5


@dataclass(frozen=True)
class GeneratedTexture:
    """A texture of the table made from a seed."""

    kind: str = required("kind of surface", choices=TEXTURE_KINDS)
    seed: int = setting(0, "seed of colour and pattern", "", 0, 2**31 - 1)


@dataclass(frozen=True)
class TableSettings:
    """The table; texture, colour and generate exclude each other."""

    centre: Optional[Tuple[float, ...]] = setting(None, "centre; default: of the workspace", "m", -10.0, 10.0, length=2)
    size: Optional[Tuple[float, ...]] = setting(
        None, "size; default: 0.25 m around the workspace", "m", 0.01, 20.0, length=2
    )
    texture: Optional[str] = setting(None, "PNG or JPEG picture, stretched over the table")
    colour: Optional[Tuple[float, ...]] = setting(
        None, "red, green, blue of a table of one colour", "", 0.0, 1.0, length=3
    )
    generate: Optional[GeneratedTexture] = None
    """Texture made from a seed; default: plain, light grey."""

    def __post_init__(self) -> None:
        """Reject contradictory surfaces."""
        if sum(value is not None for value in (self.texture, self.colour, self.generate)) > 1:
            raise ValueError("give only one of texture, colour and generate")


@dataclass(frozen=True)
class ObjectSettings:
    """One object on the table."""

    urdf: str = required("URDF file, package:// or pybullet_data:// address, or random_urdfs/000 to /999")
    position: Tuple[float, ...] = required("centre of the mesh on the table", "m", low=-10.0, high=10.0, length=2)
    yaw: float = setting(0.0, "rotation about the vertical", "rad", -_FULL_TURN, _FULL_TURN)
    scale: Optional[float] = setting(None, "factor on the size of the model", "", 1e-6, 1e6)
    size: Optional[float] = setting(None, "largest side after scaling, instead of scale", "m", 0.005, 0.5)
    height: float = setting(0.0, "underside above the table", "m", 0.0, 2.0)
    colour: Optional[Tuple[float, ...]] = setting(
        None, "red, green, blue; multiplies a texture; default: the model's own", "", 0.0, 1.0, length=(3, 4)
    )
    kind: Optional[str] = setting(None, "kind of object; default: name of the URDF")

    def __post_init__(self) -> None:
        """Reject contradictory sizes, and opacity."""
        if self.scale is not None and self.size is not None:
            raise ValueError("give only one of scale and size")
        if self.colour is not None and self.colour[3:] not in ((), (1.0,)):
            raise ValueError(f"colour has opacity {self.colour[3]:g}: transparent objects are not supported, give 1")


@dataclass(frozen=True)
class Disturbances:
    """What a real robot adds to a simulation, as standard deviations; off by default."""

    image_noise: float = setting(0.0, "noise of each pixel", "grey levels", 0.0, 255.0)
    brightness_drift: float = setting(0.0, "slow relative change of brightness", "", 0.0, 1.0)
    actuation_noise: Tuple[float, ...] = setting(
        (0.0, 0.0, 0.0), "noise of each velocity command in x, y, yaw", "m/s, m/s, rad/s", 0.0, 10.0, length=3
    )


@dataclass(frozen=True)
class Lighting:
    """Lighting of the table and exposure of the camera; off by default."""

    brightness: float = setting(1.0, "factor on all grey levels", "", 0.05, 5.0)
    gradient: float = setting(0.0, "relative change of brightness across the table", "1/m", 0.0, 5.0)
    gradient_direction: float = setting(0.0, "direction in which it becomes brighter", "rad", -_FULL_TURN, _FULL_TURN)
    shadow: float = setting(0.0, "depth of a soft shadow; 1 is black", "", 0.0, 1.0)
    shadow_centre: Optional[Tuple[float, ...]] = setting(
        None, "centre of the shadow; default: of the table", "m", -10.0, 10.0, length=2
    )
    shadow_radius: float = setting(0.08, "standard deviation of the shadow", "m", 0.005, 1.0)
    white_balance: Tuple[float, ...] = setting((1.0, 1.0, 1.0), "factors on red, green, blue", "", 0.1, 3.0, length=3)
    motion_blur: float = setting(0.0, "exposure time", "s", 0.0, 0.5)


@dataclass(frozen=True)
class WorldSettings:
    """Content of a world file."""

    table: TableSettings = field(default_factory=TableSettings)
    objects: Dict[str, ObjectSettings] = field(default_factory=dict)
    disturbances: Disturbances = field(default_factory=Disturbances)
    lighting: Lighting = field(default_factory=Lighting)
