#!/usr/bin/env python3
"""Generate the shipped models and table textures, or further textures; the output is deterministic.

    worlds/models/make_models.py                          # plant, star, stone and wood, next to this script
    worlds/models/make_models.py --textures FOLDER        # every kind of generated texture, five seeds each

A world uses a generated texture without a file: `table: {generate: {kind: marble, seed: 3}}`.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import List, Optional, Sequence, Tuple

import cv2
import numpy as np

from embodied_active_learning.simulation.table_textures import TEXTURE_KINDS, generate_texture

FOLDER = Path(__file__).resolve().parent
Triangle = Tuple[np.ndarray, np.ndarray]  # corners (3, 3) m, texture coordinates (3, 2)

# The swatches of a texture: columns, from left to right.
LEAF, POT, SOIL = 0.0, 1.0 / 3.0, 2.0 / 3.0


def fan(rim: np.ndarray, tip: np.ndarray, rim_uv: np.ndarray, tip_uv: np.ndarray) -> List[Triangle]:
    """Return triangles from each edge of a closed rim (N, 3) to one tip."""
    following, following_uv = np.roll(rim, -1, axis=0), np.roll(rim_uv, -1, axis=0)
    corners = zip(rim, following, rim_uv, following_uv)
    return [(np.array([a, b, tip]), np.array([u, v, tip_uv])) for a, b, u, v in corners]


def ring(radius: float, height: float, count: int) -> np.ndarray:
    """Return (count, 3) points on a horizontal circle."""
    angle = 2.0 * np.pi * np.arange(count) / count
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(count, height)], axis=1)


def wall(below: np.ndarray, above: np.ndarray, swatch: float) -> List[Triangle]:
    """Return triangles between two rings (N, 3)."""
    count = len(below)
    u, low, high = swatch + 1.0 / 6.0, 0.1, 0.9
    triangles = []
    for i in range(count):
        j = (i + 1) % count
        triangles.append((np.array([below[i], below[j], above[j]]), np.array([[u, low], [u, low], [u, high]])))
        triangles.append((np.array([below[i], above[j], above[i]]), np.array([[u, low], [u, high], [u, high]])))
    return triangles


def leaf(yaw: float, length: float, width: float, rise: float) -> List[Triangle]:
    """Return a folded leaf that rises from the centre of the pot and hangs over its rim."""
    left, right, u = LEAF + 0.02, LEAF + 0.31, LEAF + 1.0 / 6.0
    root = np.array([0.004, 0.0, 0.034])
    belly = np.array([0.5 * length, 0.0, 0.034 + rise])
    tip = np.array([length, 0.0, 0.030 + 0.5 * rise])
    fold = np.array([0.0, 0.5 * width, 0.007])
    corners = [
        (np.array([root, belly, belly + fold]), np.array([[u, 0.05], [u, 0.5], [left, 0.5]])),
        (np.array([root, belly - [0, 0.5 * width, -0.007], belly]), np.array([[u, 0.05], [right, 0.5], [u, 0.5]])),
        (np.array([belly + fold, belly, tip]), np.array([[left, 0.5], [u, 0.5], [u, 0.95]])),
        (np.array([belly, belly - [0, 0.5 * width, -0.007], tip]), np.array([[u, 0.5], [right, 0.5], [u, 0.95]])),
    ]
    cosine, sine = np.cos(yaw), np.sin(yaw)
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    # The renderer draws only triangles that face the camera above.
    return [(upward(points @ turn.T), uv) for points, uv in corners]


def upward(points: np.ndarray) -> np.ndarray:
    """Return a triangle's corners (3, 3) unchanged. Raises ValueError unless they are counter-clockwise from above."""
    normal = np.cross(points[1] - points[0], points[2] - points[0])
    if normal[2] <= 0.0:
        raise ValueError("a triangle of a leaf faces down: reverse its corners")
    return points


def plant() -> List[Triangle]:
    """Return a brown pot with nine leaves of different size, 8 cm across: no two yaws look alike."""
    bottom, rim = ring(0.013, 0.0, 12), ring(0.020, 0.034, 12)
    soil_uv = np.full((12, 2), [SOIL + 1.0 / 6.0, 0.5])
    triangles = wall(bottom, rim, POT)
    triangles += fan(rim, np.array([0.0, 0.0, 0.031]), soil_uv, soil_uv[0])
    yaws = np.array([0.0, 0.62, 1.45, 2.05, 2.85, 3.50, 4.30, 4.85, 5.60])
    lengths = np.array([0.048, 0.031, 0.036, 0.025, 0.041, 0.034, 0.032, 0.024, 0.037])
    widths = np.array([0.024, 0.016, 0.018, 0.014, 0.020, 0.017, 0.016, 0.013, 0.019])
    rises = np.array([0.018, 0.030, 0.014, 0.026, 0.020, 0.032, 0.016, 0.024, 0.028])
    for yaw, length, width, rise in zip(yaws, lengths, widths, rises):
        triangles += leaf(yaw, length, width, rise)
    return triangles


def star() -> List[Triangle]:
    """Return a bevelled star with five points, 8 cm across; its texture darkens along one axis to show its yaw."""
    angle = np.pi * np.arange(10) / 5.0
    radius = np.where(np.arange(10) % 2 == 0, 0.042, 0.018)
    flat = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    outline = np.column_stack([flat, np.full(10, 0.006)])
    base = np.column_stack([flat, np.zeros(10)])
    uv = 0.5 + flat / 0.09
    triangles = fan(outline, np.array([0.0, 0.0, 0.020]), uv, np.array([0.5, 0.5]))
    for i in range(10):
        j = (i + 1) % 10
        triangles.append((np.array([base[i], base[j], outline[j]]), uv[[i, j, j]]))
        triangles.append((np.array([base[i], outline[j], outline[i]]), uv[[i, j, i]]))
    return triangles


def plant_texture() -> np.ndarray:
    """Return (96, 96, 3) RGB: leaf with its light rib, pot, soil."""
    across = np.abs(np.linspace(-1.0, 1.0, 32))[None, :, None]
    along = np.linspace(1.0, 0.0, 96)[:, None, None]
    green = np.array([38.0, 128.0, 40.0]) * (0.75 + 0.35 * along) * (1.15 - 0.25 * across)
    brown = np.array([138.0, 84.0, 52.0]) * (0.9 + 0.2 * along) * np.ones((1, 32, 1))
    soil = np.array([74.0, 46.0, 32.0]) * np.ones((96, 32, 1))
    return np.concatenate([green, brown, soil], axis=1)


def star_texture() -> np.ndarray:
    """Return (64, 64, 3) RGB: red, darker towards -x."""
    along = np.linspace(0.0, 1.0, 64)[None, :, None]
    return np.array([236.0, 40.0, 44.0]) * (0.66 + 0.40 * along) * np.ones((64, 1, 1))


def stone_texture(size: int = 1024) -> np.ndarray:
    """Return (size, size, 3) RGB: light stone of low contrast, from smoothed noise at several scales."""
    generator = np.random.default_rng(7)
    grey = np.zeros((size, size))
    for cells, weight in ((6, 4.0), (12, 4.0), (24, 4.0), (48, 3.0), (96, 2.0)):
        noise = generator.standard_normal((cells, cells)).astype(np.float32)
        grey += weight * cv2.resize(noise, (size, size), interpolation=cv2.INTER_CUBIC)
    return np.array([209.0, 205.0, 196.0]) + grey[:, :, None]


def wood_texture(size: int = 1024) -> np.ndarray:
    """Return (size, size, 3) RGB: planks of light wood with grain along one axis, with more contrast than the stone."""
    generator = np.random.default_rng(11)
    grain = np.zeros((size, size))
    for across, along, weight in ((200, 6, 5.0), (100, 4, 5.0), (50, 3, 4.0)):
        noise = generator.standard_normal((across, along)).astype(np.float32)
        grain += weight * cv2.resize(noise, (size, size), interpolation=cv2.INTER_CUBIC)
    planks = 8
    tone = np.repeat(7.0 * generator.standard_normal(planks), size // planks)
    seams = np.where(np.arange(size) % (size // planks) < 3, -35.0, 0.0)
    grey = grain + (tone + seams)[:, None]
    return np.array([206.0, 178.0, 140.0]) + grey[:, :, None] * np.array([1.0, 0.95, 0.85])


def write_texture(path: Path, texture: np.ndarray) -> None:
    """Write a texture (H, W, 3) RGB, 0 to 255, as PNG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image = np.clip(np.rint(texture), 0, 255).astype(np.uint8)
    cv2.imwrite(str(path), image[:, :, ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])


def write_model(name: str, triangles: List[Triangle], texture: np.ndarray) -> None:
    """Write <name>/<name>.{obj,mtl,png,urdf}: flat-shaded triangles under one texture."""
    folder = FOLDER / name
    write_texture(folder / f"{name}.png", texture)
    (folder / f"{name}.mtl").write_text(f"newmtl {name}\nKd 1 1 1\nmap_Kd {name}.png\n", encoding="utf-8")
    lines = [f"mtllib {name}.mtl", f"usemtl {name}"]
    for corners, uv in triangles:
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        lines += ["v {:.6f} {:.6f} {:.6f}".format(*corner) for corner in corners]
        lines += ["vt {:.4f} {:.4f}".format(*coordinate) for coordinate in uv]
        lines += ["vn {:.4f} {:.4f} {:.4f}".format(*(normal / np.linalg.norm(normal)))]
    for i in range(len(triangles)):
        lines.append("f " + " ".join(f"{3 * i + k}/{3 * i + k}/{i + 1}" for k in (1, 2, 3)))
    (folder / f"{name}.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / f"{name}.urdf").write_text(
        f'<?xml version="1.0"?>\n<!-- Made by make_models.py. -->\n<robot name="{name}">\n  <link name="{name}">\n'
        f'    <visual>\n      <geometry>\n        <mesh filename="{name}.obj"/>\n      </geometry>\n'
        f"    </visual>\n  </link>\n</robot>\n",
        encoding="utf-8",
    )


def write_textures(folder: Path, seeds: int) -> int:
    """Write every kind of generated texture as KIND_SEED.png -> number of files."""
    for kind in TEXTURE_KINDS:
        for seed in range(seeds):
            write_texture(folder / f"{kind}_{seed}.png", generate_texture(kind, seed).astype(np.float64))
    return seeds * len(TEXTURE_KINDS)


def main(arguments: Optional[Sequence[str]] = None) -> None:
    """Write the shipped files next to this script, or textures into a folder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--textures", type=Path, metavar="FOLDER", help="write generated table textures there instead")
    parser.add_argument("--seeds", type=int, default=5, help="number of textures of each kind")
    options = parser.parse_args(arguments)
    if options.textures is not None:
        parser.exit(message=f"{write_textures(options.textures, options.seeds)} textures in {options.textures}\n")
    write_model("plant", plant(), plant_texture())
    write_model("star", star(), star_texture())
    write_texture(FOLDER / "table" / "stone.png", stone_texture())
    write_texture(FOLDER / "table" / "wood.png", wood_texture())


if __name__ == "__main__":
    main()
