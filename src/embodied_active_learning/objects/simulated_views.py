"""A fingerprint's own views as they would look elsewhere, and as other objects would look.

The object's pixels are cut out by the mask, put on another table and lit differently. Light from another direction is
approximated: scale the luminance pattern by cos(yaw) and add a rotated copy for the part that depends on shape.
Look-alikes are made of the same pixels: stretched, scaled, bent, mirrored or recoloured, or a plain shape in the
object's mean colour. They are harder to tell apart than most real objects, because they share either colour or shape
with it.
"""

from __future__ import annotations

from typing import Dict, List, Tuple

import cv2
import numpy as np

from embodied_active_learning.geometry import to_object_frame
from embodied_active_learning.objects.appearance import PIXEL, SIDE, Appearance, grid_cells, pixel_positions
from embodied_active_learning.objects.colours import GRADIENT_UNIT, colour_distance, colour_features, colours_of

LOOK_ALIKES = ("stretched", "scaled", "bent", "mirrored", "recoloured", "plain")
_GAIN_RANGE, _MAX_GRADIENT, _MAX_BALANCE = (-0.9, 0.4), 0.25, 0.12
"""Ranges of the light: log luminance, its change per 5 cm, log gains of the channels. They lie within the limits in
similarity.py, so that the fit can explain what is simulated."""
_NOISE = (0.0, 2.5)
"""Range of the standard deviation of the noise after the blur, in levels: up to 11 levels before it."""
_DIFFERENCE = (0.01, 0.05)
"""Range of the standard deviation of a look-alike's other differences from the object, in features: a copy with exactly
its colours is rarer than objects that resemble it. Without them a glossy object would rarely exceed its look-alikes."""
_TABLE_LUMINANCE, _TABLE_COLOUR, _TABLE_CONTRAST, _TABLE_WAVES = (-2.0, -0.1), 0.9, 0.3, (60.0, 400.0)
"""Ranges of a simulated table: log luminance, distance from grey, amplitude and wave number [rad/m] of a pattern."""
_STRETCH, _SCALES, _BEND, _BEND_WAVES = (1.2, 1.5), (0.66, 1.5), 0.012, (0.06, 0.1)
"""Ranges of a look-alike's shape: factor along one axis and across it, size, amplitude [m] and wavelength [m]."""
_RECOLOURING = (0.35, 0.8)
_ASPECT = (1.0, 3.5)
_PIXELS = pixel_positions()


class SimulatedViews:
    """Views of one simulated place: a Views whose images correspond to those of the fingerprint."""

    def __init__(self, appearance: Appearance, random: np.random.Generator, look_alike: str = "") -> None:
        """Draw table, light and, for one of LOOK_ALIKES, another object."""
        self._appearance = appearance
        self.states = appearance.fingerprint.states
        self._random = random
        self._look_alike = look_alike
        self._brightness = _draw_brightness(random)
        self._balance = random.uniform(-_MAX_BALANCE, _MAX_BALANCE, 3)
        self._table = _draw_table(random)
        self._noise = random.uniform(*_NOISE)
        self._difference = random.uniform(*_DIFFERENCE) if look_alike else 0.0
        self._kept = np.cos(random.uniform(0.0, np.pi))
        self._turn = random.uniform(0.0, 360.0)
        self._mean = appearance.inside_features[appearance.central_view].mean(axis=0)
        self._source = self._draw_source()
        self._recolouring = random.uniform(*_RECOLOURING) * _colour_direction(random)
        self._plain_mask = _draw_plain_mask(appearance.area, random)
        self._scenes: Dict[int, Tuple[np.ndarray, np.ndarray]] = {}

    def features(self, view: int, points: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Features (..., 3) at points (..., 2) of the table, and which of them are in view."""
        if view not in self._scenes:
            self._scenes[view] = self._scene(view)
        features, valid = self._scenes[view]
        seen = to_object_frame(points.reshape(-1, 2), self._appearance.fingerprint.centre)
        rows, columns, _ = grid_cells(seen.reshape(points.shape))  # beyond the border: its last pixel
        return features[rows, columns], valid[rows, columns]

    def _scene(self, view: int) -> Tuple[np.ndarray, np.ndarray]:
        """Features (SIDE, SIDE, 3) of the simulated place, and which of its pixels are in view."""
        shown, features, valid = self._object(view)
        scene = np.where(shown[..., None], features, self._table)
        scene += self._difference * self._random.standard_normal(scene.shape, dtype=np.float32)
        colours = colours_of(scene) * np.exp(self._balance + self._brightness[..., None])
        colours += self._noise * self._random.standard_normal(scene.shape, dtype=np.float32)
        return colour_features(np.rint(np.clip(colours, 0.0, 255.0)).astype(np.uint8)), valid | ~shown

    def _object(self, view: int) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The object or its look-alike: where it is shown (SIDE, SIDE), its features, and which pixels are known."""
        appearance = self._appearance
        if self._look_alike == "plain":
            plain: np.ndarray = np.broadcast_to(self._mean, (SIDE, SIDE, 3)).astype(np.float32)
            return self._plain_mask, plain, np.ones((SIDE, SIDE), dtype=bool)
        mask, valid = appearance.masks[view], appearance.in_view[view]
        features = colour_features(appearance.colours[view])
        pattern: np.ndarray = np.where(mask, features[..., 0] - self._mean[0], 0.0).astype(np.float32)
        turn = cv2.getRotationMatrix2D((SIDE / 2 - 0.5, SIDE / 2 - 0.5), self._turn, 1.0)
        turned = cv2.warpAffine(pattern, turn, (SIDE, SIDE))
        features[..., 0] = self._mean[0] + self._kept * pattern + np.sqrt(1.0 - self._kept**2) * turned
        if self._look_alike == "recoloured":
            features[..., 1:] += self._recolouring
        if not self._look_alike or self._look_alike == "recoloured":
            return mask, features, valid
        layers = np.dstack([features, mask.astype(np.float32), valid.astype(np.float32)])
        layers = cv2.remap(layers, *self._source, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
        return layers[..., 3] > 0.5, layers[..., :3], layers[..., 4] > 0.5

    def _draw_source(self) -> Tuple[np.ndarray, np.ndarray]:
        """Column and row (SIDE, SIDE) float32 of the stored view that a look-alike shows at each pixel."""
        random = self._random
        angle, wave = random.uniform(0.0, np.pi), 2.0 * np.pi / random.uniform(*_BEND_WAVES)
        axes = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        stretch = axes @ np.diag([random.uniform(*_STRETCH), 1.0 / random.uniform(*_STRETCH)]) @ axes.T
        scale, phases = random.choice(_SCALES), random.uniform(0.0, 2.0 * np.pi, 2)
        shapes = {
            "stretched": stretch,
            "scaled": scale * np.eye(2),
            "mirrored": np.diag([-1.0, 1.0]) @ axes @ np.diag([_STRETCH[0], 1.0 / _STRETCH[0]]) @ axes.T,
        }
        source = _PIXELS @ np.linalg.inv(shapes.get(self._look_alike, np.eye(2))).T
        if self._look_alike == "bent":
            source = source + _BEND * np.sin(wave * source[..., ::-1] + phases)
        columns, rows = np.moveaxis(source / PIXEL + SIDE / 2 - 0.5, -1, 0).astype(np.float32)
        return columns, rows


def _draw_brightness(random: np.random.Generator) -> np.ndarray:
    """A change (SIDE, SIDE) of the log luminance by other light."""
    gradient = random.uniform(-_MAX_GRADIENT, _MAX_GRADIENT, 2) / GRADIENT_UNIT
    return np.asarray(random.uniform(*_GAIN_RANGE) + _PIXELS @ gradient)


def _draw_table(random: np.random.Generator) -> np.ndarray:
    """Features (SIDE, SIDE, 3) of a table with a regular pattern."""
    table: np.ndarray = np.ones((SIDE, SIDE, 3), np.float32)
    waves = np.sin(random.uniform(*_TABLE_WAVES, 2) * _PIXELS + random.uniform(0.0, 2.0 * np.pi, 2))
    contrast = random.uniform(0.0, _TABLE_CONTRAST)
    table[..., 0] = random.uniform(*_TABLE_LUMINANCE) + contrast * waves[..., 0] * waves[..., 1]
    table[..., 1:] += random.uniform(0.0, _TABLE_COLOUR) * _colour_direction(random)
    return table


def _draw_plain_mask(area: float, random: np.random.Generator) -> np.ndarray:
    """An ellipse or a rectangle (SIDE, SIDE) of an area [m^2]."""
    aspect = random.uniform(*_ASPECT)
    half = 0.5 * np.sqrt([area * aspect, area / aspect])
    relative = np.abs(_PIXELS) / half
    return (relative**2).sum(axis=-1) < 4.0 / np.pi if random.random() < 0.5 else (relative < 1.0).all(axis=-1)


def _colour_direction(random: np.random.Generator) -> np.ndarray:
    """A change (2,) of the red and green shares by a distance of 1."""
    angle = random.uniform(0.0, 2.0 * np.pi)
    change = np.array([np.cos(angle), np.sin(angle)])
    return change / np.sqrt(colour_distance(change))


def draw_views(appearance: Appearance, random: np.random.Generator, count: int) -> List[int]:
    """Draw usable views without repetition, at most count."""
    usable = np.flatnonzero(appearance.usable)
    return [int(view) for view in random.choice(usable, min(count, len(usable)), replace=False)]
