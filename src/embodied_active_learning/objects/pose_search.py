"""Search for an object in a scene: candidate places from a mosaic, then the pose from views.

Candidates are the places where the mosaic is most similar to the object, at any yaw. They depend neither on the model
nor on their prominence. The similarity of points that share a few colours is a sum of
correlations, so all places are compared at once by Fourier transforms.
"""

from __future__ import annotations

from typing import List, NamedTuple, Tuple

import cv2
import numpy as np
import scipy.fft
from scipy.ndimage import maximum_filter

from embodied_active_learning.config import IdentificationConfig
from embodied_active_learning.geometry import to_base_frame
from embodied_active_learning.objects.appearance import Appearance
from embodied_active_learning.objects.colours import colour_distance, dark_factor, log_luminance, luminance_of
from embodied_active_learning.objects.scene_views import MOSAIC_PIXEL, Mosaic, SceneViews
from embodied_active_learning.objects.similarity import (
    COLOUR_SCALE,
    LUMINANCE_SCALE,
    NOT_SHOWN,
    Indices,
    Views,
    nearest_stored_views,
    similarity,
)

_YAWS = np.arange(36) * (2.0 * np.pi / 36)
_COLOURS = 3
_GAINS = (-0.9, -0.5, -0.15, 0.2)
"""Log gains between the stored views and the scene that candidates are searched with."""
_SHARE_TOLERANCE = 0.05
"""Difference of colour shares that a white balance may explain while candidates are searched."""
_PEAK_SIZE = 9
"""Side of the window in which a candidate place is the maximum, in pixels of the mosaic."""
_STARTS = 6
"""Yaws from which the pose is searched at a place."""
_CLIMBS = 3
"""Starts that are refined to their most similar pose: the first comparison may prefer a yaw wrong by half a turn."""
MIN_VIEWS = 3
"""Smallest number of views from near a place with which an object can be found there.

Calibration simulates as many: raise CALIBRATION_VERSION (objects/limits.py) if this changes.
"""
_FAR = 1.5
"""Multiple of the view distance up to which views are used if fewer are near; they can only show absence."""
_SEARCH_VIEWS = 2
"""Views in which starts are compared."""
_PROMISING = 0.5
"""Factor of the miss limit below which a start is not refined: refinement does not raise a similarity that far."""
_STEPS = ((0.004, 0.09), (0.003, 0.06), (0.0015, 0.03))
"""Steps [m, rad] of the searches around a start, around the best result, and around the best result again."""


class RefinedPose(NamedTuple):
    """The most similar pose at a candidate place.

    Attributes:
        pose: (3,) x [m], y [m], theta [rad] of the fingerprint's centre.
        similarity: Median over the views, 1 at best; NOT_SHOWN if no view shows enough of the place.
        near: Number of images from near the place.
    """

    pose: np.ndarray
    similarity: float
    near: int


class Proposals(NamedTuple):
    """Where to search.

    Attributes:
        places: For each place, the best one first, poses (Y, 3) to start from.
        table_match: Share of the scene that has the object's colours: near 1 it cannot be told from the table.
    """

    places: List[np.ndarray]
    table_match: float


def propose(mosaic: Mosaic, appearance: Appearance, count: int) -> Proposals:
    """Return the places of a mosaic that are most similar to an object, at most count."""
    view = appearance.central_view
    features = appearance.inside_features[view]
    cv2.setRNGSeed(1)
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 15, 1e-3)
    _, labels, colours = cv2.kmeans(features, _COLOURS, None, criteria, 1, cv2.KMEANS_PP_CENTERS)
    layers = [_colour_matches(mosaic, colours, gain) for gain in _GAINS]
    size, padded = len(mosaic.x), len(mosaic.x) + _padding(mosaic, appearance, view)
    transforms = [scipy.fft.rfft2(layer, s=(padded, padded)) for layer in layers]
    maps: np.ndarray = np.empty((len(_YAWS), size, size), np.float32)
    for index, yaw in enumerate(_YAWS):
        kernel = np.conj(scipy.fft.rfft2(_kernels(appearance, view, np.ravel(labels), yaw, padded)))
        correlations = [scipy.fft.irfft2((kernel * part).sum(axis=0), s=(padded, padded)) for part in transforms]
        maps[index] = np.max(correlations, axis=0)[:size, :size]
    best = np.where(mosaic.inside, maps.max(axis=0), -np.inf)
    rows, columns = np.nonzero((maximum_filter(best, _PEAK_SIZE) == best) & mosaic.inside)
    order = np.argsort(-best[rows, columns], kind="stable")[:count]
    places = [_starting_poses(mosaic, maps, rows[index], columns[index]) for index in order]
    shown = mosaic.inside & mosaic.seen
    table_match = max(float((layer[-1][shown] > 0.5).mean()) for layer in layers) if shown.any() else 0.0
    return Proposals(places, table_match)


def refine(
    appearance: Appearance,
    views: SceneViews,
    starts: np.ndarray,
    settings: IdentificationConfig,
    above: np.ndarray,
    miss: float = NOT_SHOWN,
) -> RefinedPose:
    """Return the most similar pose near the starts (Y, 3) at one place.

    Args:
        appearance: The object.
        views: The images.
        starts: Poses to start from.
        settings: How many views are compared, and from how far.
        above: (2,) camera position nearest to the place; views are taken from there.
        miss: Similarity below which the object is not there; places far below it are searched less thoroughly.
    """
    chosen = views.nearest(above, settings.views, settings.view_distance)
    near = len(chosen)
    if near < MIN_VIEWS:
        chosen = views.nearest(above, MIN_VIEWS, _FAR * settings.view_distance)
    if not len(chosen):
        return RefinedPose(starts[0], NOT_SHOWN, near)
    pose = best_pose(appearance, views, chosen, starts, min_similarity=_PROMISING * miss)
    value = similarity(appearance, views, chosen, nearest_stored_views(appearance, views, chosen, pose), pose[None])
    return RefinedPose(pose, float(value[0]), near)


def best_pose(
    appearance: Appearance,
    views: Views,
    chosen: Indices,
    starts: np.ndarray,
    excluded: Indices = (),
    min_similarity: float = NOT_SHOWN,
    stride: int = 4,
) -> np.ndarray:
    """Return the most similar pose (3,) that a search from the starts (Y, 3) reaches.

    Args:
        appearance: The object.
        views: The images.
        chosen: (V,) the images that are compared; the first ones alone decide which starts are refined.
        starts: Poses to start from.
        excluded: Stored views that are not compared with.
        min_similarity: Similarity below which a start is not refined.
        stride: Use every n-th point only while starts are compared.
    """
    poses, values = [], []
    for start in starts:
        near = _around(start, *_STEPS[0])
        stored = nearest_stored_views(appearance, views, chosen[:_SEARCH_VIEWS], start, excluded)
        found = similarity(appearance, views, chosen[:_SEARCH_VIEWS], stored, near, stride)
        poses.append(near[found.argmax()])
        values.append(float(found.max()))
    order = np.argsort(values)[::-1][:_CLIMBS]
    followed = [
        _climb(appearance, views, chosen, poses[index], excluded) for index in order if values[index] >= min_similarity
    ]
    return max(followed, key=lambda item: item[1])[0] if followed else poses[order[0]]


def _climb(
    appearance: Appearance, views: Views, chosen: Indices, pose: np.ndarray, excluded: Indices = ()
) -> Tuple[np.ndarray, float]:
    """Return a more similar pose (3,) close to a pose (3,), and its similarity in half of the points."""
    value = NOT_SHOWN
    for step in _STEPS[1:]:
        stored = nearest_stored_views(appearance, views, chosen, pose, excluded)
        near = _around(pose, *step)
        found = similarity(appearance, views, chosen, stored, near, stride=2)
        pose, value = near[found.argmax()], float(found.max())
    return pose, value


def _around(pose: np.ndarray, step: float, turn: float) -> np.ndarray:
    """(27, 3) poses around a pose (3,)."""
    axes = (np.array([-1.0, 0.0, 1.0]) * size for size in (step, step, turn))
    return pose + np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _colour_matches(mosaic: Mosaic, colours: np.ndarray, gain: float) -> np.ndarray:
    """Match (C + 1, S, S) of the mosaic with each colour (C, 3) under a gain, and the largest of these matches."""
    layers = []
    for colour in colours:
        luminance = luminance_of(colour)
        shift = mosaic.features[..., 1:] - colour[1:] / dark_factor(luminance) * mosaic.darkness[..., None]
        shift = np.sign(shift) * np.maximum(np.abs(shift) - _SHARE_TOLERANCE, 0.0)
        error = ((mosaic.features[..., 0] - log_luminance(np.exp(gain) * luminance)) / LUMINANCE_SCALE) ** 2
        layers.append(mosaic.seen / (1.0 + error + colour_distance(shift) / COLOUR_SCALE**2))
    return np.stack([*layers, np.max(layers, axis=0)]).astype(np.float32)


def _padding(mosaic: Mosaic, appearance: Appearance, view: int) -> int:
    """Pixels without a match beside the mosaic, so that no kernel reaches its opposite border: FFTs are periodic."""
    points = np.concatenate([appearance.inside_points[view], appearance.ring_points[view]])
    reach = int(np.ceil(np.hypot(*points.T).max() / MOSAIC_PIXEL)) + _PEAK_SIZE // 2
    pixels = np.argwhere(mosaic.inside)
    return max(0, reach - int(min(pixels.min(), len(mosaic.x) - 1 - pixels.max())))


def _kernels(appearance: Appearance, view: int, labels: np.ndarray, yaw: float, size: int) -> np.ndarray:
    """Kernels (C + 1, S, S) at a yaw, centred on pixel 0: of the object's points by label (I,), and of the ring."""
    kernels: np.ndarray = np.zeros((_COLOURS + 1, size, size), np.float32)
    ring_points = appearance.ring_points[view]
    for points, layer, weight in (
        (appearance.inside_points[view], labels, 1.0),
        (ring_points, np.full(len(ring_points), _COLOURS), -1.0),
    ):
        columns, rows = (
            np.rint(to_base_frame(points, np.array([[0.0, 0.0, yaw]]))[0].T / MOSAIC_PIXEL).astype(int) % size
        )
        np.add.at(kernels, (layer, rows, columns), weight / len(points))
    return kernels


def _starting_poses(mosaic: Mosaic, maps: np.ndarray, row: int, column: int) -> np.ndarray:
    """(Y, 3) poses around a pixel, at the yaws that are local maxima there, the best one first.

    Each yaw has its own best pixel, because the object turns around a centre that need not be its middle.
    """
    reach = _PEAK_SIZE // 2
    top, left = max(row - reach, 0), max(column - reach, 0)
    window = maps[:, top : row + reach + 1, left : column + reach + 1]
    flat = window.reshape(len(maps), -1)
    value = flat.max(axis=1)
    rows, columns = np.unravel_index(flat.argmax(axis=1), window.shape[1:])
    yaws = np.flatnonzero((value >= np.roll(value, 1)) & (value >= np.roll(value, -1)))
    yaws = yaws[np.argsort(-value[yaws], kind="stable")][:_STARTS]
    return np.stack([mosaic.x[left + columns[yaws]], mosaic.y[top + rows[yaws]], _YAWS[yaws]], axis=-1)
