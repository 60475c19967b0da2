"""Where the learned objects are: mean-shift clusters of what is hard to predict (paper, appendix, fingerprinting)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Tuple

import numpy as np
from scipy.spatial import cKDTree
from sklearn.cluster import MeanShift

from embodied_active_learning.config import Config, FingerprintConfig
from embodied_active_learning.geometry import table_points, wrap
from embodied_active_learning.model.trained_model import TrainedModel
from embodied_active_learning.objects.fingerprint import BLANK, OBJECT
from embodied_active_learning.objects.salience import Background
from embodied_active_learning.rng import Stream, generator
from embodied_active_learning.workspace import Workspace

_POOL = 20
"""Uniform states for each importance sample."""
_PIXELS = 4
"""Points of the table drawn for each importance sample."""
_STRIDE = 4
"""Pixels between those that are drawn from."""
_BLANK_SHARE = 0.2
"""Share of the workspace, the easiest to predict, in which the blank region is sought."""
_BLANK_BANDWIDTH = 0.06  # m
_LEAST_BACKGROUND = 20
"""Images that the table's colour is taken from, at least."""
_BACKGROUND_SHARE = 0.1


@dataclass(frozen=True)
class Cluster:
    """One learned object, or the blank region."""

    kind: str
    centre: np.ndarray  # (3,) m, m, rad
    share: float  # of the importance samples; of the workspace's easiest states for a blank


@dataclass(frozen=True)
class Clustering:
    """What the conditional entropy says about the workspace."""

    contrast: float  # largest over smallest predicted standard deviation
    flat: bool  # so even that there is nothing to find: no clusters then
    clusters: Tuple[Cluster, ...]  # objects, the largest share first, then one blank
    unreachable: Tuple[Cluster, ...]  # objects whose centre the camera cannot come over


def find_objects(model: TrainedModel, states: np.ndarray, images: np.ndarray, config: Config, seed: int) -> Clustering:
    """Cluster the importance samples of the conditional entropy, averaged over latents of observations drawn at random.

    states: (N, 3) [m, m, rad] and images: (N, H, W, 3) uint8 that the model learned from. One seed gives one result.
    """
    settings, random = config.fingerprint, generator(seed, Stream.CLUSTERING)
    chosen = np.sort(random.choice(len(states), min(settings.latents, len(states)), replace=False))
    latents, _ = model.encode(states[chosen], images[chosen])
    box = config.workspace.box()
    pool = random.uniform(box.lower, box.upper, (_POOL * settings.samples, box.size))
    std = np.exp(model.log_std(latents, pool)).mean(axis=0)
    low, high = np.quantile(std, (0.001, 0.999))
    contrast = float(high / low)
    if contrast < settings.min_contrast:
        return Clustering(contrast, True, (), ())
    weights = (std / std.max()) ** settings.exponent
    samples = pool[random.choice(len(pool), settings.samples, p=weights / weights.sum())]
    if settings.clustering == "camera":
        points, yaws, drawn = samples[:, :2], samples[:, 2], len(samples)
    else:
        seen_std = np.exp(model.log_std(latents, states)).mean(axis=0)
        easiest = np.argsort(seen_std)[: max(_LEAST_BACKGROUND, int(_BACKGROUND_SHARE * len(states)))]
        points, yaws = _salient_points(samples, states, images, Background(images[easiest]), config, random)
        drawn = _PIXELS * len(samples)
    objects = _cluster(points, yaws, drawn, settings, box)
    reachable = [bool(np.abs((box.clip(c.centre) - c.centre)[:2]).max() <= settings.view_std) for c in objects]
    return Clustering(
        contrast,
        False,
        (
            *(found for found, within in zip(objects, reachable) if within),
            *_blank(pool[std <= np.quantile(std, _BLANK_SHARE)]),
        ),
        tuple(found for found, within in zip(objects, reachable) if not within),
    )


def _salient_points(
    samples: np.ndarray,
    states: np.ndarray,
    images: np.ndarray,
    background: Background,
    config: Config,
    random: np.random.Generator,
) -> Tuple[np.ndarray, np.ndarray]:
    """Points of the table (P, 2) that stand out in what was seen next to each sample (S, 3), and the yaws (P,) there.

    The entropy of a camera state tells that something in view is hard to predict, but not where in the view: its peak
    is as wide as the camera's footprint, and leans towards the border of the workspace. What stands out from the views
    that are easy to predict says where.
    """
    box = config.workspace.box()
    _, nearest = cKDTree(box.normalise(states)).query(box.normalise(samples))
    points, yaws = [np.empty((0, 2))], [np.empty(0)]
    for index in nearest:
        salience = background.salience(images[index][::_STRIDE, ::_STRIDE])
        total = salience.sum()
        if total < 1.0:
            continue  # less than one pixel: noise
        drawn = random.choice(salience.size, _PIXELS, p=(salience / total).ravel())
        rows, columns = np.divmod(drawn, salience.shape[1])
        state = states[index]
        points.append(table_points(np.tile(state, (_PIXELS, 1)), rows * _STRIDE, columns * _STRIDE, config.camera))
        yaws.append(np.full(_PIXELS, state[2]))
    return np.concatenate(points), np.concatenate(yaws)


def _cluster(
    points: np.ndarray, yaws: np.ndarray, drawn: int, settings: FingerprintConfig, box: Workspace
) -> List[Cluster]:
    """Clusters of points (P, 2) [m], the largest first, without those that are too small or too close to a larger.

    drawn: how many points there would be if every sample had given its share.
    """
    if len(points) <= drawn * settings.min_share:
        return []
    shift = MeanShift(bandwidth=settings.bandwidth, bin_seeding=True, cluster_all=False).fit(points)
    found = []
    for label, centre in enumerate(shift.cluster_centers_):
        members = shift.labels_ == label
        yaw = float(wrap(math.atan2(np.sin(yaws[members]).sum(), np.cos(yaws[members]).sum())))
        # Yaws on both sides of the limits have their mean beyond them.
        yaw = min(max(yaw, box.lower[2]), box.upper[2])
        found.append(Cluster(OBJECT, np.array([*centre, yaw]), float(members.sum() / drawn)))
    kept: List[Cluster] = []
    for cluster in sorted(found, key=lambda item: -item.share):
        distances = [np.hypot(*(cluster.centre - other.centre)[:2]) for other in kept]
        if cluster.share >= settings.min_share and min(distances, default=math.inf) >= settings.merge_distance:
            kept.append(cluster)
    return kept


def _blank(states: np.ndarray) -> List[Cluster]:
    """The largest region among the states (B, 3) that are easiest to predict; yaw makes no difference there."""
    shift = MeanShift(bandwidth=_BLANK_BANDWIDTH, bin_seeding=True, cluster_all=False).fit(states[:, :2])
    sizes = np.bincount(shift.labels_[shift.labels_ >= 0])
    largest = int(sizes.argmax())
    return [Cluster(BLANK, np.array([*shift.cluster_centers_[largest], 0.0]), float(sizes[largest] / len(states)))]
