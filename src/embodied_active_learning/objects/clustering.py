"""Locations of the learned objects: mean-shift clusters of conditional-entropy samples.

Paper, appendix "Object Fingerprinting": importance sampling of the conditional entropy, then mean-shift clustering;
"blank" regions are valid objects.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from typing import List, Tuple

import numpy as np
from scipy.spatial import cKDTree

from embodied_active_learning.config import CAMERA, TABLE, Config, FingerprintConfig
from embodied_active_learning.geometry import table_points, wrap
from embodied_active_learning.model.trained_model import TrainedModel
from embodied_active_learning.objects.fingerprint import BLANK, OBJECT
from embodied_active_learning.objects.foreground_map import ForegroundMap, map_foreground
from embodied_active_learning.objects.mean_shift import mean_shift
from embodied_active_learning.objects.salience import Background
from embodied_active_learning.rng import Stream, generator
from embodied_active_learning.workspace import Workspace

_LOG = logging.getLogger(__name__)

_FITTING_BANDWIDTHS = {CAMERA: (0.07, 0.12), TABLE: (0.02, 0.07)}
"""Bandwidths [m] with which each kind of clustering locates objects well.

The entropy of camera states has peaks as wide as the footprint of the camera; table points spread over one object.
"""
_PROPOSALS_PER_SAMPLE = 20
"""Uniformly drawn states per importance sample."""
_PIXELS_PER_SAMPLE = 4
"""Table points drawn per importance sample."""
_PIXEL_STRIDE = 4
"""Table points are drawn from every fourth row and column of an image."""
_BLANK_SHARE = 0.2
"""Share of the workspace, with the lowest entropy, in which the blank region is searched."""
_BLANK_BANDWIDTH = 0.06  # m
_MIN_BACKGROUND_IMAGES = 20
_BACKGROUND_SHARE = 0.1
"""Share of the images, with the lowest entropy, that the table's colour is fitted to."""
_CONTRAST_QUANTILES = (0.001, 0.999)
"""Quantiles that stand for the smallest and the largest predicted standard deviation."""


@dataclass(frozen=True)
class Cluster:
    """A learned object, or the blank region.

    Attributes:
        kind: OBJECT or BLANK.
        centre: (3,) x [m], y [m], theta [rad] in the base frame.
        share: Share of the clustered points in the cluster; of the lowest-entropy states for a blank region.
    """

    kind: str
    centre: np.ndarray
    share: float


@dataclass(frozen=True)
class Clustering:
    """Clusters of the conditional entropy over the workspace.

    Attributes:
        contrast: Largest over smallest predicted standard deviation.
        low_contrast: Whether the contrast is below `fingerprint/min_contrast`; there are no clusters then.
        clusters: Objects, largest share first, then the blank region, if it was located.
        unreachable: Objects over whose centre the camera cannot be moved.
        visible: All visible things, whether or not the model has learned them, and prints, which the clustering of
            table points leaves out.
        background: Colours of the table.
    """

    contrast: float
    low_contrast: bool
    clusters: Tuple[Cluster, ...]
    unreachable: Tuple[Cluster, ...]
    visible: ForegroundMap
    background: Background


def find_objects(
    model: TrainedModel, states: np.ndarray, images: np.ndarray, config: Config, seed: int, blank: bool = True
) -> Clustering:
    """Cluster importance samples of the conditional entropy, averaged over the latents of randomly drawn observations.

    Paper, appendix "Object Fingerprinting". The weight of a state is proportional to the conditional entropy
    distribution exp(H)^k (Paper, Sec. "Control Formulation"), where exp(H) is proportional to the predicted standard
    deviation and k is `fingerprint/exponent`. The paper clusters the camera states (`fingerprint/clustering: camera`).
    The default, `table`, clusters table points of foreground pixels instead, which assumes more than the paper does: a
    camera that looks straight down from a known height with a known field of view, and a table whose colours are
    roughly Gaussian. Of these clusters only visible things are objects: a table's texture also has points that differ
    from its colours, but no place where most do. Points in the plane of the table, such as prints, are left out.

    Args:
        model: The model of the session.
        states: (N, 3) x [m], y [m], theta [rad] of the observations the model learned from.
        images: (N, H, W, 3) uint8, the images of these observations.
        config: The session's configuration.
        seed: One seed gives one result.
        blank: Whether to locate a blank region, which takes half of the time.
    """
    settings, random = config.fingerprint, generator(seed, Stream.CLUSTERING)
    chosen = np.sort(random.choice(len(states), min(settings.latents, len(states)), replace=False))
    latents, _ = model.encode(states[chosen], images[chosen])
    workspace = config.workspace.box()
    proposals, std = _sample_entropy(model, latents, settings.samples, workspace, random)
    low, high = np.quantile(std, _CONTRAST_QUANTILES)
    contrast = float(high / low)
    background = _background(model, latents, states, images)
    visible = map_foreground(states, images, background, config)
    if contrast < settings.min_contrast:
        return Clustering(
            contrast, low_contrast=True, clusters=(), unreachable=(), visible=visible, background=background
        )
    weights = (std / std.max()) ** settings.exponent
    samples = proposals[random.choice(len(proposals), settings.samples, p=weights / weights.sum())]
    if settings.clustering == TABLE:
        points, yaws = _foreground_points(samples, states, images, background, config, random)
        objects = _visible_clusters(points, yaws, visible, settings, workspace)
    else:
        objects = _cluster(samples[:, :2], samples[:, 2], settings, workspace)
    reachable = [_is_reachable(cluster, workspace, settings) for cluster in objects]
    # The paper's clustering of camera states makes no use of the camera's geometry.
    things = visible.things if settings.clustering == TABLE else np.empty((0, 2))
    half_view = config.camera.distance * math.tan(0.5 * math.radians(config.camera.field_of_view))
    blanks = [_blank_region(proposals[std <= np.quantile(std, _BLANK_SHARE)], things, half_view)] if blank else []
    return Clustering(
        contrast,
        low_contrast=False,
        clusters=(*(cluster for cluster, within in zip(objects, reachable) if within), *blanks),
        unreachable=tuple(cluster for cluster, within in zip(objects, reachable) if not within),
        visible=visible,
        background=background,
    )


def _sample_entropy(
    model: TrainedModel, latents: np.ndarray, samples: int, workspace: Workspace, random: np.random.Generator
) -> Tuple[np.ndarray, np.ndarray]:
    """Draw states (P, 3) uniformly, and return them with their predicted standard deviation (P,).

    Args:
        model: The model of the session.
        latents: (N, L) over which the standard deviation is averaged.
        samples: Number of importance samples that the states are for.
        workspace: Where to draw from.
        random: Generator of the draws.
    """
    states = random.uniform(workspace.lower, workspace.upper, (_PROPOSALS_PER_SAMPLE * samples, workspace.size))
    return states, np.exp(model.log_std(latents, states)).mean(axis=0)


def warn_about_bandwidth(settings: FingerprintConfig) -> None:
    """Log a warning if the bandwidth does not fit the kind of clustering."""
    low, high = _FITTING_BANDWIDTHS[settings.clustering]
    if not low <= settings.bandwidth <= high:
        _LOG.warning(
            "fingerprint/bandwidth %g m does not fit clustering: %s: expect wrong centres or merged objects; set it "
            "to %g to %g m",
            settings.bandwidth, settings.clustering, low, high,
        )  # fmt: skip


def _background(model: TrainedModel, latents: np.ndarray, states: np.ndarray, images: np.ndarray) -> Background:
    """Fit the table's colour to the images with the lowest conditional entropy."""
    std = np.exp(model.log_std(latents, states)).mean(axis=0)
    count = max(_MIN_BACKGROUND_IMAGES, int(_BACKGROUND_SHARE * len(states)))
    return Background(images[np.argsort(std)[:count]])


def _foreground_points(
    samples: np.ndarray,
    states: np.ndarray,
    images: np.ndarray,
    background: Background,
    config: Config,
    random: np.random.Generator,
) -> Tuple[np.ndarray, np.ndarray]:
    """Draw table points (P, 2) [m] of foreground pixels in the image nearest to each sample (S, 3), and its yaw (P,).

    The entropy of a camera state shows that something in view is hard to predict, but not where in the image: its peak
    is as wide as the camera's footprint, and biased towards the border of the workspace.
    """
    workspace = config.workspace.box()
    _, nearest = cKDTree(workspace.normalise(states)).query(workspace.normalise(samples))
    points, yaws = [np.empty((0, 2))], [np.empty(0)]
    for index in nearest:
        salience = background.salience(images[index][::_PIXEL_STRIDE, ::_PIXEL_STRIDE])
        total = salience.sum()
        if total < 1.0:
            continue  # less than one pixel is noise
        drawn = random.choice(salience.size, _PIXELS_PER_SAMPLE, p=(salience / total).ravel())
        rows, columns = np.divmod(drawn, salience.shape[1])
        state = states[index]
        repeated = np.tile(state, (_PIXELS_PER_SAMPLE, 1))
        points.append(table_points(repeated, rows * _PIXEL_STRIDE, columns * _PIXEL_STRIDE, config.camera))
        yaws.append(np.full(_PIXELS_PER_SAMPLE, state[2]))
    return np.concatenate(points), np.concatenate(yaws)


def _visible_clusters(
    points: np.ndarray, yaws: np.ndarray, visible: ForegroundMap, settings: FingerprintConfig, workspace: Workspace
) -> List[Cluster]:
    """Cluster those of the table points (P, 2) [m] with yaws (P,) where something stands; keep what is visible."""
    standing = visible.stands_at(points)
    clusters = _cluster(points[standing], yaws[standing], settings, workspace)
    return [cluster for cluster in clusters if _is_near(visible.things, cluster.centre, settings.merge_distance)]


def _cluster(points: np.ndarray, yaws: np.ndarray, settings: FingerprintConfig, workspace: Workspace) -> List[Cluster]:
    """Cluster points (P, 2) [m] with yaws (P,), largest first, without clusters that are small or near a larger one."""
    if not len(points):
        return []
    centres, labels = mean_shift(points, settings.bandwidth, bin_seeding=True, cluster_all=False)
    found = []
    for label, centre in enumerate(centres):
        members = labels == label
        yaw = _mean_yaw(yaws[members], workspace)
        found.append(Cluster(OBJECT, np.array([*centre, yaw]), float(members.mean())))
    kept: List[Cluster] = []
    for cluster in sorted(found, key=lambda item: -item.share):
        distances = [np.hypot(*(cluster.centre - other.centre)[:2]) for other in kept]
        if cluster.share >= settings.min_share and min(distances, default=math.inf) >= settings.merge_distance:
            kept.append(cluster)
    return kept


def _is_near(things: np.ndarray, centre: np.ndarray, distance: float) -> bool:
    """Return whether one of the things (N, 2) lies within a distance of a centre (3,); all in metres."""
    return bool((np.hypot(*(things - centre[:2]).T) <= distance).any())


def _mean_yaw(yaws: np.ndarray, workspace: Workspace) -> float:
    """Circular mean of yaws (M,) [rad], clipped: the mean of yaws near both limits may lie beyond one of them."""
    mean = float(wrap(np.arctan2(np.sin(yaws).sum(), np.cos(yaws).sum())))
    return min(max(mean, workspace.lower[2]), workspace.upper[2])


def _blank_region(states: np.ndarray, things: np.ndarray, clearance: float) -> Cluster:
    """Return the largest cluster of the states (B, 3) with the lowest entropy that is clear of all things (K, 2) [m].

    If none is, the model does not predict the bare table best yet, and the clearest cluster is returned. Yaw is
    irrelevant there and set to 0.

    Args:
        states: (B, 3) x [m], y [m], theta [rad].
        things: (K, 2) centres of visible things [m].
        clearance: Smallest distance [m] from the centre of a cluster to a thing.
    """
    centres, labels = mean_shift(states[:, :2], _BLANK_BANDWIDTH, bin_seeding=True, cluster_all=False)
    sizes = np.bincount(labels[labels >= 0], minlength=len(centres))
    nearest = np.linalg.norm(centres[:, np.newaxis] - things, axis=-1).min(axis=1, initial=math.inf)
    best = int(np.where(nearest >= clearance, sizes, 0).argmax())
    if nearest[best] < clearance:
        best = int(nearest.argmax())
        _LOG.warning(
            "the blank region is %.1f cm from an object, whose views will show it: make the fingerprints again after "
            "more steps",
            100.0 * nearest[best],
        )
    return Cluster(BLANK, np.array([*centres[best], 0.0]), float(sizes[best] / len(states)))


def _is_reachable(cluster: Cluster, workspace: Workspace, settings: FingerprintConfig) -> bool:
    """Whether the camera can be moved to within `view_std` of the cluster's centre, in x and in y."""
    return bool(np.abs((workspace.clip(cluster.centre) - cluster.centre)[:2]).max() <= settings.view_std)
