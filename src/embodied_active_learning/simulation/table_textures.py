"""Generate table textures from seeds: plain, wood, cloth, tiles, marble, print and noise, in several colours each."""

from __future__ import annotations

import zlib
from typing import Callable, Dict, Sequence, Tuple

import cv2
import numpy as np

SIZE = 1024
"""Side of a texture in pixels: below one millimetre on a table of 0.8 m."""

Rgb = Tuple[float, float, float]
_PALETTES: Dict[str, Sequence[Rgb]] = {
    "plain": ((209, 204, 196), (128, 131, 134), (232, 232, 228), (70, 84, 104), (150, 170, 140), (196, 160, 120)),
    "wood": ((206, 178, 140), (150, 106, 70), (98, 66, 46), (224, 204, 172), (176, 120, 90)),
    "cloth": ((60, 80, 130), (170, 60, 60), (216, 206, 184), (70, 110, 80), (110, 110, 116)),
    "tiles": ((214, 210, 200), (150, 168, 178), (120, 90, 76), (90, 120, 110), (236, 232, 224)),
    "marble": ((228, 226, 222), (70, 74, 78), (196, 206, 200), (222, 200, 184)),
    "print": ((236, 232, 220), (58, 92, 120), (208, 176, 90), (180, 200, 190), (96, 60, 80)),
    "noise": ((180, 178, 172), (110, 116, 110), (140, 110, 90), (90, 100, 130)),
}
TEXTURE_KINDS = tuple(_PALETTES)


def generate_texture(kind: str, seed: int, size: int = SIZE) -> np.ndarray:
    """Return a texture (size, size, 3) uint8 RGB; the same for the same kind and seed."""
    generator = np.random.default_rng([zlib.crc32(kind.encode()), seed])
    palette = _PALETTES[kind]
    colour: np.ndarray = np.array(palette[generator.integers(len(palette))], dtype=np.float64)
    colour = np.clip(colour * generator.uniform(0.92, 1.08) + generator.uniform(-8.0, 8.0, 3), 20.0, 236.0)
    return np.clip(np.rint(_PATTERNS[kind](colour, size, generator)), 0, 255).astype(np.uint8)


def smooth_noise(size: int, cells: Sequence[Tuple[int, int, float]], generator: np.random.Generator) -> np.ndarray:
    """Noise (size, size), summed over scales (cells down, cells across, standard deviation)."""
    total = np.zeros((size, size))
    for down, across, weight in cells:
        noise: np.ndarray = generator.standard_normal((down, across)).astype(np.float32)
        total += weight * cv2.resize(noise, (size, size), interpolation=cv2.INTER_CUBIC)
    return total


def _plain(colour: np.ndarray, size: int, generator: np.random.Generator) -> np.ndarray:
    """One colour with faint grain: no two places look exactly alike."""
    return colour + smooth_noise(size, ((8, 8, 1.5), (256, 256, 1.5)), generator)[:, :, None]


def _wood(colour: np.ndarray, size: int, generator: np.random.Generator) -> np.ndarray:
    """Planks with grain."""
    grain = smooth_noise(size, ((200, 6, 5.0), (100, 4, 5.0), (50, 3, 4.0)), generator)
    planks = int(generator.integers(5, 10))
    plank = np.arange(size) * planks // size
    seam = np.where(np.diff(plank, prepend=plank[0]) > 0, -35.0, 0.0)
    seam = seam + np.roll(seam, 1)
    tone = 7.0 * generator.standard_normal(planks)
    texture = colour + (grain + (tone[plank] + seam)[:, None])[:, :, None] * np.array([1.0, 0.95, 0.85])
    return texture if generator.random() < 0.5 else texture.transpose(1, 0, 2)


def _cloth(colour: np.ndarray, size: int, generator: np.random.Generator) -> np.ndarray:
    """Woven checks with visible threads."""
    period = int(generator.integers(60, 140))
    band = (np.arange(size) // (period // 2)) % 2
    checks = (band[:, None] + band[None, :]) / 2.0
    accent = np.array([235.0, 230.0, 220.0]) if colour.mean() < 150 else 0.6 * colour
    strength = generator.uniform(0.25, 0.7)
    mixed = colour + strength * checks[:, :, None] * (accent - colour)
    rows, columns = np.indices((size, size))
    threads = np.where((rows // 3 + columns // 3) % 2, 5.0, -5.0)
    return mixed + (threads + smooth_noise(size, ((128, 128, 3.0),), generator))[:, :, None]


def _tiles(colour: np.ndarray, size: int, generator: np.random.Generator) -> np.ndarray:
    """Square tiles of varying tone with joints."""
    count = int(generator.integers(5, 11))
    index = np.arange(size) * count // size
    joint = (np.arange(size) * count % size) < 5 * count
    tone = generator.normal(0.0, 9.0, (count, count))[index[:, None], index[None, :]]
    texture = colour + (tone + smooth_noise(size, ((64, 64, 2.0), (256, 256, 1.5)), generator))[:, :, None]
    texture[joint[:, None] | joint[None, :]] = 0.55 * colour + 40.0
    return texture


def _marble(colour: np.ndarray, size: int, generator: np.random.Generator) -> np.ndarray:
    """Clouds with winding veins."""
    rows, columns = np.indices((size, size)) / size
    angle = generator.uniform(0.0, np.pi)
    along = np.cos(angle) * columns + np.sin(angle) * rows
    bent = along + 0.05 * smooth_noise(size, ((5, 5, 1.0), (14, 14, 0.5)), generator)
    veins = np.exp(-np.abs(np.sin(generator.uniform(8.0, 16.0) * bent)) / 0.06)
    vein = 70.0 * np.ones(3) if colour.mean() > 128 else 215.0 * np.ones(3)
    clouds = smooth_noise(size, ((6, 6, 4.0), (30, 30, 3.0)), generator)
    return colour + clouds[:, :, None] + 0.5 * veins[:, :, None] * (vein - colour)


def _print(colour: np.ndarray, size: int, generator: np.random.Generator) -> np.ndarray:
    """A printed tablecloth: discs, rings and lines in a few colours at random places."""
    texture: np.ndarray = np.full((size, size, 3), np.clip(colour, 0, 255), dtype=np.uint8)
    inks = generator.uniform(30.0, 225.0, (4, 3))
    for _ in range(int(generator.integers(60, 140))):
        ink = inks[generator.integers(len(inks))].tolist()
        x, y, other_x, other_y = generator.integers(0, size, 4).tolist()
        radius, shape = int(generator.integers(8, 40)), int(generator.integers(3))
        if shape == 0:
            cv2.circle(texture, (x, y), radius, ink, -1, cv2.LINE_AA)
        elif shape == 1:
            cv2.circle(texture, (x, y), radius, ink, 4, cv2.LINE_AA)
        else:
            end = (x + (other_x - x) // 6, y + (other_y - y) // 6)
            cv2.line(texture, (x, y), end, ink, 5, cv2.LINE_AA)
    return texture + smooth_noise(size, ((256, 256, 1.5),), generator)[:, :, None]


def _noise(colour: np.ndarray, size: int, generator: np.random.Generator) -> np.ndarray:
    """Coloured noise at several scales, like terrazzo or a worn bench."""
    cells = ((8, 8, 9.0), (32, 32, 9.0), (128, 128, 9.0))
    return colour + np.stack([smooth_noise(size, cells, generator) for _ in range(3)], axis=-1)


_PATTERNS: Dict[str, Callable[[np.ndarray, int, np.random.Generator], np.ndarray]] = {
    "plain": _plain,
    "wood": _wood,
    "cloth": _cloth,
    "tiles": _tiles,
    "marble": _marble,
    "print": _print,
    "noise": _noise,
}
