"""Clustering of a known entropy over images of a painted table."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
import pytest

from embodied_active_learning.config import Config, FingerprintConfig
from embodied_active_learning.geometry import pose_distance
from embodied_active_learning.objects.clustering import find_objects, warn_about_bandwidth
from embodied_active_learning.objects.fingerprint import BLANK, OBJECT
from embodied_active_learning.objects.foreground_map import ForegroundMap
from painted_table import Thing, paint, random_states

WIDTH = 0.05
"""Standard deviation [m] of the entropy peaks, about the width of the camera's footprint."""
TWO = (Thing(0, (0.40, -0.07, 0.5)), Thing(1, (0.54, 0.06, -1.0)))


def configuration(fingerprint=None, **workspace):
    pinned = {
        "samples": 500,
        "bandwidth": 0.045,
        "exponent": 3.0,
        "min_contrast": 2.0,
        "view_std": 0.015,
        "min_share": 0.05,
        "prints": True,  # the discs have no height
    }
    fingerprint = {**pinned, **(fingerprint or {})}
    return Config.from_dict({"camera": {"width": 45, "height": 45}, "workspace": workspace, "fingerprint": fingerprint})


CONFIG = configuration()


class Entropy:
    """A model whose predicted standard deviation peaks at given places, at all yaws or near the yaw of the place."""

    def __init__(self, places, contrast=6.0, yaw_width=math.inf, heights=None):
        self.places = np.array(places, dtype=float).reshape(-1, 3)
        self.contrast, self.yaw_width = contrast, yaw_width
        self.heights = np.ones(len(places)) if heights is None else np.array(heights)
        self.images = 0

    def encode(self, states, images):
        self.images += len(images)
        latents = np.arange(2 * len(states), dtype=np.float32).reshape(-1, 2)
        return latents, np.ones_like(latents)

    def log_std(self, latents, states):
        return np.stack([np.log(self.std(states))] * len(latents))

    def std(self, states, places=slice(None)):
        distance, turn = pose_distance(states[:, None], self.places[places])
        peaks = np.exp(-0.5 * np.square(distance / WIDTH) - 0.5 * np.square(turn / self.yaw_width))
        peaks *= self.heights[places]
        return 0.01 * (1.0 + (self.contrast - 1.0) * peaks.max(axis=1, initial=0.0))


class Halves(Entropy):
    """A model in which each latent knows every other place: even latents the first, third, ...; odd ones the rest."""

    def log_std(self, latents, states):
        return np.log([self.std(states, slice(int(latent[0]) // 2 % 2, None, 2)) for latent in latents])


@functools.lru_cache(maxsize=None)
def explored(things, theta=CONFIG.workspace.theta, count=300):
    """Return states and images of a run over a noisy table."""
    states = random_states(configuration(theta=list(theta)).workspace.box(), count)
    return states, paint(states, things, CONFIG.camera, noise=8.0)


def cluster_table(things, config=CONFIG, count=300, entropy=None, seed=0, **model):
    """Cluster a table with things on it, by default with a model whose entropy peaks at the things."""
    states, images = explored(tuple(things), config.workspace.theta, count)
    entropy = entropy or Entropy([thing.pose for thing in things], **model)
    return find_objects(entropy, states, images, config, seed)


def objects(clustering):
    return [cluster for cluster in clustering.clusters if cluster.kind == OBJECT]


def assert_found(clusters, things, within=0.005):
    """Check that there is exactly one cluster near each thing."""
    assert len(clusters) == len(things)
    assert max(errors(clusters, things), default=0.0) < within


def errors(clusters, things):
    """Return the distance [m] from each thing to its nearest cluster."""
    centres = np.array([cluster.centre[:2] for cluster in clusters]).reshape(-1, 2)
    return [np.linalg.norm(centres - thing.pose[:2], axis=1).min() for thing in things]


@pytest.fixture(scope="module")
def two():
    return cluster_table(TWO)


def test_clusters_match_objects_within_5_mm(two):
    assert not two.low_contrast
    assert two.unreachable == ()
    assert_found(objects(two), TWO)


def test_clusters_sorted_by_share_of_samples(two):
    shares = [cluster.share for cluster in objects(two)]
    assert shares == sorted(shares, reverse=True)
    assert 0.5 < sum(shares) <= 1.0


def test_blank_is_last_and_away_from_objects(two):
    assert [cluster.kind for cluster in two.clusters] == [OBJECT, OBJECT, BLANK]
    blank = two.clusters[-1]
    for thing in TWO:
        assert np.hypot(*(blank.centre[:2] - thing.pose[:2])) > thing.radius + WIDTH
    assert CONFIG.workspace.box().contains(blank.centre)
    assert 0.0 < blank.share <= 1.0


CORNER = (Thing(0, (0.58, 0.10, 0.0)),)


def test_blank_is_clear_of_a_thing_that_the_model_predicts_well():
    blank = cluster_table(CORNER, entropy=Entropy([(0.40, -0.04, 0.0)])).clusters[-1]
    assert np.hypot(*(blank.centre[:2] - CORNER[0].pose[:2])) > 0.08


def test_blank_beside_a_thing_is_warned_about(caplog):
    cluster_table(CORNER, entropy=Entropy([(0.36, -0.12, 0.0)]))
    assert "from an object, whose views will show it" in caplog.text


def test_contrast_equals_that_of_model(two):
    assert two.contrast == pytest.approx(6.0, rel=0.05)


@pytest.mark.parametrize(("radius", "within"), [(0.02, 0.005), (0.03, 0.005), (0.045, 0.015)])
def test_objects_9_cm_apart_are_separated(radius, within):
    """Also if they touch."""
    things = (Thing(0, (0.43, -0.02, 0.0), radius), Thing(1, (0.52, -0.02, 0.0), radius))
    assert_found(objects(cluster_table(things)), things, within)


def test_object_at_border_is_found():
    things = (*TWO, Thing(2, (0.61, -0.12, 0.0), 0.015))
    assert_found(objects(cluster_table(things)), things)


def test_large_object_is_one_cluster():
    things = (Thing(0, (0.47, 0.01, 0.0), 0.06),)
    assert_found(objects(cluster_table(things)), things, within=0.03)


@pytest.mark.parametrize("seed", [1, 2])
def test_clusters_robust_to_seed(two, seed):
    assert_found(objects(cluster_table(TWO, seed=seed)), TWO)


def test_clustering_is_deterministic_per_seed(two):
    again, other = cluster_table(TWO), cluster_table(TWO, seed=1)
    assert [cluster.share for cluster in again.clusters] == [cluster.share for cluster in two.clusters]
    for cluster, expected in zip(again.clusters, two.clusters):
        np.testing.assert_array_equal(cluster.centre, expected.centre)
    assert [cluster.share for cluster in other.clusters] != [cluster.share for cluster in two.clusters]


@pytest.mark.parametrize("contrast", [1.0, 1.9])
def test_flat_entropy_gives_no_clusters(contrast):
    found = cluster_table(TWO, contrast=contrast, count=30)
    assert found.low_contrast
    assert found.contrast < 2.0
    assert found.clusters == found.unreachable == ()


def test_min_contrast_sets_flatness_limit():
    config = configuration({"min_contrast": 7.0})
    assert cluster_table(TWO, config, count=30).low_contrast
    assert not cluster_table(TWO, config, count=30, contrast=8.0).low_contrast


def test_uneven_entropy_on_bare_table_is_no_object():
    found = cluster_table((), entropy=Entropy([TWO[0].pose]), count=200)
    assert not found.low_contrast
    assert [cluster.kind for cluster in found.clusters] == [BLANK]
    assert found.unreachable == ()


def test_object_outside_camera_range_is_unreachable():
    beyond = Thing(2, (0.665, 0.0, 0.0))
    found = cluster_table((TWO[0], beyond))
    assert_found(objects(found), TWO[:1])
    assert [cluster.kind for cluster in found.unreachable] == [OBJECT]
    assert_found(found.unreachable, [beyond], within=0.01)


def test_object_beyond_border_reachable_within_view_std():
    things = (TWO[0], Thing(2, (0.634, 0.0, 0.0)))
    assert_found(objects(cluster_table(things)), things, within=0.008)
    found = cluster_table(things, configuration({"view_std": 0.002}))
    assert_found(objects(found), TWO[:1])
    assert len(found.unreachable) == 1


def test_clusters_within_merge_distance_keep_larger():
    things = (Thing(0, (0.43, 0.0, 0.0)), Thing(1, (0.52, 0.0, 0.0)))
    assert_found(objects(cluster_table(things, heights=[0.8, 1.0])), things)
    merged = cluster_table(things, configuration({"merge_distance": 0.12}), heights=[0.8, 1.0])
    assert_found(objects(merged), things[1:])


def test_cluster_below_min_share_is_dropped():
    both = objects(cluster_table(TWO, heights=[1.0, 0.6]))
    assert_found(both, TWO)
    assert both[0].share > 2.0 * both[1].share
    found = cluster_table(TWO, configuration({"min_share": both[1].share + 1e-6}), heights=[1.0, 0.6])
    assert_found(objects(found), TWO[:1])


@pytest.mark.parametrize("clustering", ["table", "camera"])
def test_cluster_yaw_is_circular_mean(clustering):
    bandwidth = 0.09 if clustering == "camera" else 0.045
    config = configuration({"clustering": clustering, "bandwidth": bandwidth}, theta=[-math.pi, math.pi])
    thing = Thing(0, (0.47, 0.01, math.pi))
    found = objects(cluster_table([thing], config, yaw_width=0.4))
    assert_found(found, [thing], within=0.01)
    _, turn = pose_distance(found[0].centre, np.array(thing.pose))
    assert turn < 0.3


def test_cluster_yaw_follows_high_entropy_views():
    thing = Thing(0, (0.47, 0.01, 1.0))
    found = objects(cluster_table([thing], yaw_width=0.4))
    assert found[0].centre[2] == pytest.approx(1.0, abs=0.1)


def test_camera_clustering_uses_camera_states():
    config = configuration({"clustering": "camera", "bandwidth": 0.09})
    things = (Thing(0, (0.40, -0.08, 0.5)), Thing(1, (0.55, 0.07, -1.0)))
    found = cluster_table((), config, count=50, entropy=Entropy([thing.pose for thing in things]))
    assert_found(objects(found), things, within=0.02)
    assert [cluster.kind for cluster in found.clusters] == [OBJECT, OBJECT, BLANK]


@pytest.mark.parametrize(
    ("clustering", "bandwidth", "warned"), [("camera", 0.045, True), ("camera", 0.09, False), ("table", 0.09, True)]
)
def test_bandwidth_that_does_not_fit_clustering_is_warned_about(caplog, clustering, bandwidth, warned):
    warn_about_bandwidth(FingerprintConfig(clustering=clustering, bandwidth=bandwidth))
    expected = f"fingerprint/bandwidth {bandwidth} m does not fit clustering: {clustering}"
    assert (expected in caplog.text) is warned


def test_entropy_is_averaged_over_latents():
    assert_found(objects(cluster_table(TWO, entropy=Halves([thing.pose for thing in TWO]))), TWO)


@pytest.mark.parametrize(("asked", "count", "encoded"), [(7, 40, 7), (1, 40, 1), (50, 40, 40)])
def test_latent_count_limited_by_images(asked, count, encoded):
    entropy = Entropy([], contrast=1.0)
    cluster_table((), configuration({"latents": asked}), count=count, entropy=entropy)
    assert entropy.images == encoded


def test_larger_exponent_concentrates_samples():
    shares = []
    for exponent in (1.0, 4.0):
        config = configuration({"exponent": exponent, "clustering": "camera", "bandwidth": 0.09})
        found = cluster_table((), config, count=50, entropy=Entropy([TWO[0].pose]))
        shares.append(objects(found)[0].share)
    assert shares[1] > shares[0] + 0.1


def test_slightly_brighter_table_is_no_object():
    states = random_states(CONFIG.workspace.box(), 100)
    images = paint(states, (), CONFIG.camera, noise=0.0)
    near, _ = pose_distance(states, np.array(TWO[0].pose))
    images[near < 0.06, :20] += 2
    found = find_objects(Entropy([TWO[0].pose]), states, images, CONFIG, 0)
    assert objects(found) == []


def test_cluster_without_visible_thing_is_no_object(monkeypatch):
    """Such as one of a table's texture."""
    things = np.array([TWO[0].pose[:2], (0.60, -0.12)])
    monkeypatch.setattr(ForegroundMap, "things", things)
    found = cluster_table(TWO)
    assert_found(objects(found), TWO[:1])
    np.testing.assert_array_equal(found.visible.things, things)


@pytest.mark.parametrize("prints", [False, True])
def test_prints_are_objects_only_on_request(prints):
    things = (TWO[0]._replace(height=0.03), TWO[1])
    config = replace(
        CONFIG,
        camera=replace(CONFIG.camera, width=90, height=90),
        fingerprint=replace(CONFIG.fingerprint, prints=prints),
    )
    states = random_states(config.workspace.box(), 300)
    images = paint(states, things, config.camera)
    found = find_objects(Entropy([thing.pose for thing in things]), states, images, config, 0)
    of_print = np.hypot(*(found.visible.things - things[1].pose[:2]).T) < 0.03
    assert of_print.any() == prints
    assert_found(objects(found), things if prints else things[:1], within=0.01)
    assert len(found.visible.prints) == (0 if prints else 1)
    assert np.all(np.hypot(*(found.visible.prints - things[1].pose[:2]).T) < 0.005)
