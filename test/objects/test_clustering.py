"""Objects are found where they were painted, from an entropy that is known and from photographs of the table."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest

from embodied_active_learning.config import Config
from embodied_active_learning.geometry import pose_distance
from embodied_active_learning.objects.clustering import find_objects
from embodied_active_learning.objects.fingerprint import BLANK, OBJECT
from painted_table import Thing, paint, random_states

WIDTH = 0.05
"""Of the peaks of the entropy: as wide as what the camera sees [m]."""
TWO = (Thing(0, (0.40, -0.07, 0.5)), Thing(1, (0.54, 0.06, -1.0)))


def configuration(fingerprint=None, **workspace):
    pinned = {
        "samples": 500,
        "bandwidth": 0.045,
        "exponent": 3.0,
        "min_contrast": 2.0,
        "view_std": 0.015,
        "min_share": 0.05,
    }
    fingerprint = {**pinned, **(fingerprint or {})}
    return Config.from_dict({"camera": {"width": 45, "height": 45}, "workspace": workspace, "fingerprint": fingerprint})


CONFIG = configuration()


class Entropy:
    """A model that is as unsure as a state is near to one of its places, in every view or only in those of a yaw."""

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
    """Each latent is unsure near one of the places only: of these the first, third ..., of those the second ..."""

    def log_std(self, latents, states):
        return np.log([self.std(states, slice(int(latent[0]) // 2 % 2, None, 2)) for latent in latents])


@functools.lru_cache(maxsize=None)
def explored(things, theta=CONFIG.workspace.theta, count=300):
    """States and photographs of a run over a table of rather uneven colour."""
    states = random_states(configuration(theta=list(theta)).workspace.box(), count)
    return states, paint(states, things, CONFIG.camera, noise=8.0)


def look(things, config=CONFIG, count=300, entropy=None, seed=0, **model):
    """What is found of painted things, by a model that is unsure near them unless another entropy is given."""
    states, images = explored(tuple(things), config.workspace.theta, count)
    entropy = entropy or Entropy([thing.pose for thing in things], **model)
    return find_objects(entropy, states, images, config, seed)


def objects(clustering):
    return [cluster for cluster in clustering.clusters if cluster.kind == OBJECT]


def assert_found(clusters, things, within=0.005):
    """Each of the things has its own cluster, and there are no others."""
    assert len(clusters) == len(things)
    assert sorted(errors(clusters, things))[-1] < within


def errors(clusters, things):
    """Distance from each thing to its nearest cluster [m]."""
    centres = np.array([cluster.centre[:2] for cluster in clusters])
    return [np.linalg.norm(centres - thing.pose[:2], axis=1).min() for thing in things]


@pytest.fixture(scope="module")
def two():
    return look(TWO)


def test_exactly_the_painted_objects_are_found_within_5_millimetres(two):
    assert not two.flat
    assert two.unreachable == ()
    assert_found(objects(two), TWO)


def test_shares_are_of_the_samples_and_the_largest_comes_first(two):
    shares = [cluster.share for cluster in objects(two)]
    assert shares == sorted(shares, reverse=True)
    assert 0.5 < sum(shares) <= 1.0


def test_one_blank_comes_last_and_away_from_all_objects(two):
    assert [cluster.kind for cluster in two.clusters] == [OBJECT, OBJECT, BLANK]
    blank = two.clusters[-1]
    for thing in TWO:
        assert np.hypot(*(blank.centre[:2] - thing.pose[:2])) > thing.radius + WIDTH
    assert CONFIG.workspace.box().contains(blank.centre)
    assert 0.0 < blank.share <= 1.0


def test_contrast_is_that_of_the_model(two):
    assert two.contrast == pytest.approx(6.0, rel=0.05)


@pytest.mark.parametrize(("radius", "within"), [(0.02, 0.005), (0.03, 0.005), (0.045, 0.015)])
def test_two_objects_9_centimetres_apart_are_two_even_if_they_touch(radius, within):
    things = (Thing(0, (0.43, -0.02, 0.0), radius), Thing(1, (0.52, -0.02, 0.0), radius))
    assert_found(objects(look(things)), things, within)


def test_of_three_objects_the_one_next_to_the_border_is_found_too():
    things = (*TWO, Thing(2, (0.61, -0.12, 0.0), 0.015))
    assert_found(objects(look(things)), things)


def test_object_that_nearly_fills_the_image_is_one():
    things = (Thing(0, (0.47, 0.01, 0.0), 0.06),)
    assert_found(objects(look(things)), things, within=0.03)


@pytest.mark.parametrize("seed", [1, 2])
def test_other_seeds_find_the_same_objects(two, seed):
    assert_found(objects(look(TWO, seed=seed)), TWO)


def test_one_seed_gives_one_result(two):
    again, other = look(TWO), look(TWO, seed=1)
    assert [cluster.share for cluster in again.clusters] == [cluster.share for cluster in two.clusters]
    for cluster, expected in zip(again.clusters, two.clusters):
        np.testing.assert_array_equal(cluster.centre, expected.centre)
    assert [cluster.share for cluster in other.clusters] != [cluster.share for cluster in two.clusters]


@pytest.mark.parametrize("contrast", [1.0, 1.9])
def test_nothing_is_found_where_the_entropy_is_flat(contrast):
    found = look(TWO, contrast=contrast, count=30)
    assert found.flat
    assert found.contrast < 2.0
    assert found.clusters == found.unreachable == ()


def test_how_flat_is_flat_can_be_set():
    config = configuration({"min_contrast": 7.0})
    assert look(TWO, config, count=30).flat
    assert not look(TWO, config, count=30, contrast=8.0).flat


def test_uneven_entropy_over_a_bare_table_is_no_object():
    found = look((), entropy=Entropy([TWO[0].pose]), count=200)
    assert not found.flat
    assert [cluster.kind for cluster in found.clusters] == [BLANK]
    assert found.unreachable == ()


def test_object_that_the_camera_cannot_come_over_is_unreachable():
    beyond = Thing(2, (0.665, 0.0, 0.0))
    found = look((TWO[0], beyond))
    assert_found(objects(found), TWO[:1])
    assert [cluster.kind for cluster in found.unreachable] == [OBJECT]
    assert_found(found.unreachable, [beyond], within=0.01)


def test_object_just_beyond_the_border_is_reached_as_far_as_views_are_spread():
    things = (TWO[0], Thing(2, (0.634, 0.0, 0.0)))
    assert_found(objects(look(things)), things, within=0.008)
    found = look(things, configuration({"view_std": 0.002}))
    assert_found(objects(found), TWO[:1])
    assert len(found.unreachable) == 1


def test_two_clusters_closer_than_the_merge_distance_are_one_the_larger():
    things = (Thing(0, (0.43, 0.0, 0.0)), Thing(1, (0.52, 0.0, 0.0)))
    assert_found(objects(look(things, heights=[0.8, 1.0])), things)
    merged = look(things, configuration({"merge_distance": 0.12}), heights=[0.8, 1.0])
    assert_found(objects(merged), things[1:])


def test_cluster_with_too_small_a_share_is_no_object():
    both = objects(look(TWO, heights=[1.0, 0.6]))
    assert_found(both, TWO)
    assert both[0].share > 2.0 * both[1].share
    found = look(TWO, configuration({"min_share": both[1].share + 1e-6}), heights=[1.0, 0.6])
    assert_found(objects(found), TWO[:1])


@pytest.mark.parametrize("clustering", ["table", "camera"])
def test_yaws_on_both_sides_of_pi_have_their_mean_there_and_not_at_zero(clustering):
    bandwidth = 0.09 if clustering == "camera" else 0.045
    config = configuration({"clustering": clustering, "bandwidth": bandwidth}, theta=[-math.pi, math.pi])
    thing = Thing(0, (0.47, 0.01, math.pi))
    found = objects(look([thing], config, yaw_width=0.4))
    assert_found(found, [thing], within=0.01)
    _, turn = pose_distance(found[0].centre, np.array(thing.pose))
    assert turn < 0.3


def test_yaw_of_a_cluster_is_that_of_the_views_that_are_hard_to_predict():
    thing = Thing(0, (0.47, 0.01, 1.0))
    found = objects(look([thing], yaw_width=0.4))
    assert found[0].centre[2] == pytest.approx(1.0, abs=0.1)


def test_the_cameras_own_positions_are_clustered_on_request():
    config = configuration({"clustering": "camera", "bandwidth": 0.09})
    things = (Thing(0, (0.40, -0.08, 0.5)), Thing(1, (0.55, 0.07, -1.0)))
    found = look((), config, count=50, entropy=Entropy([thing.pose for thing in things]))  # without looking
    assert_found(objects(found), things, within=0.02)
    assert [cluster.kind for cluster in found.clusters] == [OBJECT, OBJECT, BLANK]


def test_entropy_is_averaged_over_latents_of_which_each_knows_a_part():
    assert_found(objects(look(TWO, entropy=Halves([thing.pose for thing in TWO]))), TWO)


@pytest.mark.parametrize(("asked", "count", "encoded"), [(7, 40, 7), (1, 40, 1), (50, 40, 40)])
def test_as_many_latents_as_asked_for_are_encoded_if_there_are_so_many_images(asked, count, encoded):
    entropy = Entropy([], contrast=1.0)
    look((), configuration({"latents": asked}), count=count, entropy=entropy)
    assert entropy.images == encoded


def test_a_larger_exponent_leaves_more_of_the_samples_at_the_peaks():
    shares = []
    for exponent in (1.0, 4.0):
        config = configuration({"exponent": exponent, "clustering": "camera", "bandwidth": 0.09})
        found = look((), config, count=50, entropy=Entropy([TWO[0].pose]))
        shares.append(objects(found)[0].share)
    assert shares[1] > shares[0] + 0.1


def test_a_plain_table_that_is_a_little_brighter_somewhere_is_no_object():
    states = random_states(CONFIG.workspace.box(), 100)
    images = paint(states, (), CONFIG.camera, noise=0.0)
    near, _ = pose_distance(states, np.array(TWO[0].pose))
    images[near < 0.06, :20] += 2
    found = find_objects(Entropy([TWO[0].pose]), states, images, CONFIG, 0)
    assert objects(found) == []
