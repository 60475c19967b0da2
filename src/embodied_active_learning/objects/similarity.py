"""How much a view shows of an object where it would be at a pose.

The similarity is the mean match of the object's points minus that of the ring around it: 1 if the object is there and
contrasts with the table, about 0 on anything else, including a larger surface of the same colour. A match falls from 1
to 0 with the squared difference of features, so single pixels (highlights, an occlusion) have little weight. Light is
corrected by a gain, a gradient of the gain and a white balance, fitted to the object's points.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol, Sequence, Tuple, Union

import numpy as np

from embodied_active_learning.geometry import to_base_frame, to_object_frame
from embodied_active_learning.objects.appearance import Appearance
from embodied_active_learning.objects.colours import (
    GRADIENT_UNIT,
    balance_jacobian,
    colour_distance,
    dark_factor,
    log_luminance,
    luminance_of,
)
from embodied_active_learning.objects.medians import masked_median

Indices = Union[Sequence[int], np.ndarray]
NOT_SHOWN = -1.0
"""Similarity where no view shows enough of the object; the lowest one."""
LUMINANCE_SCALE, COLOUR_SCALE = 0.2, 0.12
"""Differences of log luminance and of colour at which a match is 1/2. The object's own contrast is added:
shading moves over an object that is turned under a fixed light."""
_MAX_CONTRAST = (0.2, 0.1)
"""Upper limits of the contrast that is added: more contrast is a pattern of several colours, not shading."""
_GAIN_LIMITS = (-1.0, 0.6)
"""Limits of the gain: log luminance of the view minus that of the stored view."""
_MAX_GRADIENT = 0.3
"""Limit of its change per 5 cm."""
_GRADIENT_PRIOR = 12.0
_MAX_BALANCE = 0.26
"""Limit of the white balance: largest difference between the log gains of two channels."""
_BALANCE_PRIOR = 0.01
"""Weight of a prior of no change, relative to that of the points, for channels that the object does not reflect."""
_MIN_INSIDE, _MIN_RING = 0.6, 0.25
"""Share of the points that must be in view. If too little of the ring is, its match is assumed to be _UNSEEN_RING."""
_UNSEEN_RING = 0.3


class Views(Protocol):
    """Images that can be sampled at points of the table: a SceneViews, or simulated ones."""

    states: np.ndarray

    def features(self, view: int, points: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Features (..., 3) of an image at points (..., 2), and which of them are in view."""
        ...


class Points(NamedTuple):
    """Points of an object in a stored view."""

    positions: np.ndarray  # (K, 2) m, in the object's coordinates
    luminance: np.ndarray  # (K,)
    shares: np.ndarray  # (K, 2) of red and green, not regularised
    jacobian: np.ndarray  # (K, 2, 2), see balance_jacobian; of the stored view, although the view may be darker


class Light(NamedTuple):
    """A correction for each of P poses."""

    gain: np.ndarray  # (P,)
    gradient: np.ndarray  # (P, 2) per 5 cm along the object's x and y
    balance: np.ndarray  # (P, 2) log gains of red and green relative to blue


def similarity(
    appearance: Appearance,
    views: Views,
    chosen: Indices,
    stored: Indices,
    poses: np.ndarray,
    stride: int = 1,
) -> np.ndarray:
    """Return the median similarity (P,) over views at P poses; NOT_SHOWN where no view shows enough of the object.

    Args:
        appearance: The object.
        views: The images.
        chosen: (V,) the images that are compared.
        stored: (V,) the stored view that each of them is compared with.
        poses: (P, 3) poses of the object [m, m, rad].
        stride: Use every n-th point only.
    """
    values = np.array(
        [_similarity_in_view(appearance, views, one, other, poses, stride) for one, other in zip(chosen, stored)]
    )
    return masked_median(values, values > NOT_SHOWN, 0, NOT_SHOWN)


def nearest_stored_views(
    appearance: Appearance, views: Views, chosen: Indices, pose: np.ndarray, excluded: Indices = ()
) -> np.ndarray:
    """Return the stored view (V,) to compare each chosen image with, for an object at a pose (3,)."""
    return appearance.nearest_views(to_object_frame(views.states[np.asarray(chosen)], pose), excluded)


def matches(
    appearance: Appearance, views: Views, view: int, stored: int, pose: np.ndarray
) -> Tuple[np.ndarray, np.ndarray]:
    """Return the match, 0 to 1, of the points inside the object (I,) and of the ring (R,) at one pose (3,)."""
    poses = np.asarray(pose)[None]
    inside, ring = _points(appearance, stored)
    seen, valid = views.features(view, to_base_frame(inside.positions, poses))
    seen_ring, _ = views.features(view, to_base_frame(ring.positions, poses))
    of_inside, of_ring = _matches(seen, valid, seen_ring, inside, ring, _scale(appearance))
    return of_inside[0], of_ring[0]


def _scale(appearance: Appearance) -> Tuple[float, float]:
    """Differences of log luminance and of colour at which a match with an object is 1/2."""
    luminance, colour = np.minimum(appearance.contrast, _MAX_CONTRAST)
    return float(np.hypot(LUMINANCE_SCALE, luminance)), float(np.hypot(COLOUR_SCALE, colour))


def _similarity_in_view(
    appearance: Appearance, views: Views, view: int, stored: int, poses: np.ndarray, stride: int
) -> np.ndarray:
    """Similarity (P,) in one view; NOT_SHOWN where it does not show enough of the object."""
    inside, ring = _points(appearance, stored, stride)
    seen, inside_valid = views.features(view, to_base_frame(inside.positions, poses))
    seen_ring, ring_valid = views.features(view, to_base_frame(ring.positions, poses))
    match, match_of_ring = _matches(seen, inside_valid, seen_ring, inside, ring, _scale(appearance))
    of_inside, of_ring = _mean(match, inside_valid), _mean(match_of_ring, ring_valid)
    of_ring = np.where(ring_valid.mean(axis=1) < _MIN_RING, _UNSEEN_RING, of_ring)
    return np.where(inside_valid.mean(axis=1) < _MIN_INSIDE, NOT_SHOWN, of_inside - of_ring)


def _points(appearance: Appearance, stored: int, stride: int = 1) -> Tuple[Points, Points]:
    """Points inside the object in a stored view, and those of the ring."""
    inside = (appearance.inside_points[stored, ::stride], appearance.inside_features[stored, ::stride])
    ring = (appearance.ring_points[stored, ::stride], appearance.ring_features[stored, ::stride])
    return _points_with(*inside), _points_with(*ring)


def _points_with(positions: np.ndarray, features: np.ndarray) -> Points:
    luminance = luminance_of(features)
    shares = features[:, 1:] / dark_factor(luminance)[:, None]
    return Points(positions, luminance, shares, balance_jacobian(features))


def _matches(
    seen: np.ndarray, valid: np.ndarray, seen_ring: np.ndarray, inside: Points, ring: Points, scale: Tuple[float, float]
) -> Tuple[np.ndarray, np.ndarray]:
    """Match of the points inside (P, I) and of the ring (P, R), in light that is fitted to the valid ones inside."""
    luminance = luminance_of(seen)
    gain: np.ndarray = masked_median(np.log(luminance / inside.luminance), valid, 1, 0.0).astype(np.float32)
    change = _change(seen, luminance, inside, gain)
    light = _fit_light(change, valid, inside, scale, gain)
    change_of_ring = _change(seen_ring, luminance_of(seen_ring), ring, gain)
    return _match(change, inside, light, scale), _match(change_of_ring, ring, light, scale)


def _change(features: np.ndarray, luminance: np.ndarray, points: Points, gain: np.ndarray) -> np.ndarray:
    """Feature differences (P, K, 3) between a view and the stored points at the brightness of the view.

    The gain (P,) is applied to the luminance of the stored points, and the luminance (P, K) of the view to their
    shares, before they are regularised. The first component still contains the gain, which _fit_light refines.
    """
    change: np.ndarray = np.empty_like(features)
    expected = log_luminance(np.exp(gain)[:, None] * points.luminance)
    change[..., 0] = features[..., 0] - expected + gain[:, None]
    change[..., 1:] = features[..., 1:] - points.shares * dark_factor(luminance)[..., None]
    return change


def _fit_light(
    change: np.ndarray, valid: np.ndarray, points: Points, scale: Tuple[float, float], gain: np.ndarray
) -> Light:
    """Robust fit of the light to changes (P, K, 3) of points, of which (P, K) are valid, starting from a gain (P,)."""
    luminance = change[..., 0]
    x, y = (points.positions / GRADIENT_UNIT).T
    seen: np.ndarray = valid.astype(np.float32)
    gradient: np.ndarray = np.zeros((len(gain), 2), np.float32)
    weight = seen
    for _ in range(2):
        error = luminance - gain[:, None] - gradient[:, :1] * x - gradient[:, 1:] * y
        weight = seen / (1.0 + (error / scale[0]) ** 2)
        step = (weight * error).sum(axis=1) / (weight.sum(axis=1) + 1e-6)
        gain, error = gain + step, error - step[:, None]
        xx, xy, yy = (weight @ product for product in (x * x, x * y, y * y))
        xx, yy = xx + _GRADIENT_PRIOR, yy + _GRADIENT_PRIOR
        ex, ey = ((weight * error) @ axis for axis in (x, y))
        ex, ey = ex - _GRADIENT_PRIOR * gradient[:, 0], ey - _GRADIENT_PRIOR * gradient[:, 1]
        determinant = xx * yy - xy**2
        gradient = gradient + np.stack([yy * ex - xy * ey, xx * ey - xy * ex], axis=-1) / determinant[:, None]
    balance = _fit_balance(change[..., 1:], weight, points.jacobian)
    return Light(np.clip(gain, *_GAIN_LIMITS), np.clip(gradient, -_MAX_GRADIENT, _MAX_GRADIENT), balance)


def _fit_balance(change: np.ndarray, weight: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
    """White balance (P, 2): weighted least squares for changes (P, K, 2) of the shares with a Jacobian (K, 2, 2)."""
    prior = _BALANCE_PRIOR * weight.sum(axis=1) + 1e-6
    normal = weight @ np.einsum("kij,kil->kjl", jacobian, jacobian).reshape(-1, 4)
    right = (weight * change[..., 0]) @ jacobian[:, 0] + (weight * change[..., 1]) @ jacobian[:, 1]
    xx, xy, yy = normal[:, 0] + prior, normal[:, 1], normal[:, 3] + prior
    solution = np.stack([yy * right[:, 0] - xy * right[:, 1], xx * right[:, 1] - xy * right[:, 0]], axis=-1)
    gains = solution / (xx * yy - xy**2)[:, None]
    largest = np.maximum(np.abs(gains).max(axis=1), np.abs(gains[:, 0] - gains[:, 1]))
    return np.asarray(gains * np.minimum(1.0, _MAX_BALANCE / np.maximum(largest, 1e-6))[:, None])


def _match(change: np.ndarray, points: Points, light: Light, scale: Tuple[float, float]) -> np.ndarray:
    """Match (P, K), 0 to 1, of changes (P, K, 3) of the features of points: 1 if the light explains them."""
    x, y = (points.positions / GRADIENT_UNIT).T
    error = change[..., 0] - light.gain[:, None] - light.gradient[:, :1] * x - light.gradient[:, 1:] * y
    red, green = np.moveaxis(points.jacobian, -1, 0)
    explained = light.balance[:, None, :1] * red + light.balance[:, None, 1:] * green
    colour = colour_distance(change[..., 1:] - explained)
    return np.asarray(1.0 / (1.0 + (error / scale[0]) ** 2 + colour / scale[1] ** 2))


def _mean(values: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Mean (P,) of the valid values (P, K)."""
    return (values * valid).sum(axis=1) / np.maximum(valid.sum(axis=1), 1)
