"""The measurement: an image is like the stored view that shows the same, and says where the object would be then."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from embodied_active_learning.config import Config, IdentificationConfig
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.geometry import move, pose_distance
from embodied_active_learning.objects.fingerprint import OBJECT, Fingerprint
from embodied_active_learning.objects.matching import PIXELS, Matcher
from painted_table import Thing, paint

LATENTS = IdentificationConfig()
BY_PIXELS = IdentificationConfig(features="pixels")
CAMERA = Config.from_dict({"camera": {"width": 45, "height": 45}}).camera
RED, BLUE = Thing(0, (0.42, -0.05, 0.6)), Thing(1, (0.53, 0.06, -1.0))
POSES = st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-math.pi, math.pi)).map(np.array)


class ImageLatents:
    """A model whose latent is what the image shows, wherever it is told that the image was taken."""

    def __init__(self, of_image=None):
        self.of_image = of_image or (lambda image: image.reshape(-1, 3)[:4].astype(np.float32).ravel() / 10.0)
        self.features = self.pairs = 0

    def image_features(self, images):
        self.features += len(images)
        return np.stack([self.of_image(image) for image in images])

    def encode_pairs(self, states, features):
        self.pairs += len(states) * len(features)
        return np.repeat(features[:, None], len(states), axis=1)


class StateLatents(ImageLatents):
    """A model whose latent also depends on the state that the encoder is told."""

    def encode_pairs(self, states, features):
        return super().encode_pairs(states, features) + np.float32(1.0) * np.tile(states[:, :1], 12).astype(np.float32)


def random_images(count, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (count, 45, 45, 3), dtype=np.uint8)


def make_fingerprint(name, states, images, latents=None, centre=(0.45, 0.02, 0.3)):
    latents = ImageLatents().image_features(images) if latents is None else np.asarray(latents, np.float32)
    return Fingerprint(
        name, OBJECT, np.array(centre), np.array(states), images, latents, np.full_like(latents, 0.1), 0.2
    )


def random_fingerprint(name, views, seed, **fields):
    states = np.random.default_rng(seed).uniform((0.4, -0.05, -2.0), (0.5, 0.05, 2.0), (views, 3))
    return make_fingerprint(name, states, random_images(views, seed), **fields)


def from_latents(name, latents):
    """A fingerprint of given latents (V, L), of which the images do not matter."""
    return make_fingerprint(name, np.zeros((len(latents), 3)), np.zeros((len(latents), 45, 45, 3), np.uint8), latents)


FIRST, SECOND = random_fingerprint("object-1", 6, 1), random_fingerprint("object-2", 4, 2)


@pytest.mark.parametrize("settings_", [LATENTS, BY_PIXELS])
def test_a_stored_view_is_its_own_match_at_distance_0_with_value_088(settings_):
    matcher = Matcher(ImageLatents(), [FIRST, SECOND], settings_)
    for index, item in enumerate((FIRST, SECOND)):
        own = matcher.match(item.states, item.images)[index]
        np.testing.assert_array_equal(own.view, np.arange(len(item.states)))
        np.testing.assert_allclose(own.distance, 0.0, atol=1e-3)
        np.testing.assert_allclose(own.value, 0.5 + 0.5 * math.tanh(1.0), atol=1e-3)
        np.testing.assert_allclose(own.pose, np.tile(item.centre, (len(item.states), 1)), atol=1e-12)


def test_views_of_another_fingerprint_have_a_value_of_at_most_one_half():
    matcher = Matcher(ImageLatents(), [FIRST, SECOND], LATENTS)
    values = np.concatenate(
        [matcher.match(FIRST.states, FIRST.images)[1].value, matcher.match(*states_of(SECOND))[0].value]
    )
    assert values.max() == pytest.approx(0.5, abs=1e-4)
    assert np.sum(values > 0.499) == 2  # the two views between which the smallest distance is


def states_of(item):
    return item.states, item.images


def test_threshold_is_the_smallest_distance_between_views_of_different_fingerprints():
    one, other, third = [[0, 0], [0, 1]], [[3, 5], [3, 9]], [[-10, 1], [-10, 0.5]]
    matcher = Matcher(
        ImageLatents(), [from_latents(f"object-{i}", x) for i, x in enumerate((one, other, third))], LATENTS
    )
    assert matcher.threshold == pytest.approx(5.0)
    assert matcher.largest == pytest.approx(math.hypot(13, 8.5))


def test_threshold_of_a_single_fingerprint_is_the_smallest_distance_between_its_own_views():
    matcher = Matcher(ImageLatents(), [from_latents("object-1", [[0, 0], [0, 3], [8, 3]])], LATENTS)
    assert matcher.threshold == pytest.approx(3.0)
    assert matcher.largest == pytest.approx(math.hypot(8, 3))


def test_value_falls_with_the_distance_through_one_half_at_the_threshold():
    matcher = Matcher(
        ImageLatents(), [from_latents("object-1", [[0.0]]), from_latents("object-2", [[2.0], [7.0]])], LATENTS
    )
    # Between threshold 2 and largest 7: half a tanh on either side, as wide as 2 and as 2 * 7 - 2.
    distances = np.array([0.0, 1.0, 2.0, 8.0, 14.0])
    expected = 0.5 + 0.5 * np.tanh([1.0, 0.5, 0.0, -0.5, -1.0])
    np.testing.assert_allclose(matcher.value(distances), expected, atol=1e-6)
    assert np.all(np.diff(matcher.value(np.linspace(0.0, 30.0, 300))) < 0.0)
    assert np.all(matcher.value(np.linspace(0.0, 30.0, 300)) > 0.0)


def test_values_stay_finite_when_views_of_two_fingerprints_are_equal():
    matcher = Matcher(ImageLatents(), [from_latents("object-1", [[1.0]]), from_latents("object-2", [[1.0]])], LATENTS)
    values = matcher.value(np.array([0.0, 1e-12, 1.0, 100.0]))
    assert np.all((values >= 0.0) & (values <= 1.0))
    assert values[0] == pytest.approx(0.88, abs=0.01)


def test_single_view_is_refused_and_two_fingerprints_of_one_view_each_are_not():
    one, other = (random_fingerprint(f"object-{seed}", 1, seed) for seed in (1, 2))
    with pytest.raises(ObservationError, match="a single view leaves nothing to tell"):
        Matcher(ImageLatents(), [one], LATENTS)
    assert Matcher(ImageLatents(), [one, other], LATENTS).match(*states_of(one))[0].value[0] > 0.87


def test_distance_is_between_the_stored_latent_and_that_of_the_image_at_the_stored_state():
    model, at = StateLatents(), np.array([[0.9, 0.0, 0.0]])
    items = [FIRST, SECOND]
    found = Matcher(model, items, LATENTS).match(at, random_images(1, 9))
    for item, matches in zip(items, found):
        latent = model.of_image(random_images(1, 9)[0]) + item.states[:, :1]
        distances = np.linalg.norm(latent - item.latent_means, axis=1)
        assert matches.view[0] == distances.argmin()
        assert matches.distance[0] == pytest.approx(distances.min(), rel=1e-5)


@settings(max_examples=30, deadline=None)
@given(POSES, st.integers(0, 2**31 - 1))
def test_pose_of_an_object_that_was_moved_is_found_exactly(goal, seed):
    """The camera looks at the moved object as it once looked at the stored one: the images are the same."""
    origin = FIRST.centre
    order = np.random.default_rng(seed).permutation(len(FIRST.states))
    states = move(FIRST.states[order], origin, goal)
    matches = Matcher(ImageLatents(), [FIRST, SECOND], LATENTS).match(states, FIRST.images[order])[0]
    np.testing.assert_array_equal(matches.view, order)
    distance, turn = pose_distance(matches.pose, goal)
    assert distance.max() < 1e-9
    assert turn.max() < 1e-9


@pytest.mark.parametrize("settings_", [LATENTS, BY_PIXELS])
def test_an_image_is_encoded_once_for_all_fingerprints_and_not_at_all_for_pixels(settings_):
    model = ImageLatents()
    matcher = Matcher(model, [FIRST, SECOND], settings_)
    assert model.features == model.pairs == 0
    found = matcher.match(np.zeros((3, 3)), random_images(3))
    assert [matches.view.shape for matches in found] == [(3,), (3,)]
    assert (model.features, model.pairs) == ((3, 3 * 10) if settings_ is LATENTS else (0, 0))


def test_pixels_find_the_moved_object_without_a_model():
    """Two painted things that differ in colour are told apart, and where each stands is read from the images alone."""
    random, items = np.random.default_rng(0), []
    for name, thing in (("object-1", RED), ("object-2", BLUE)):
        states = random.normal(thing.pose, (0.015, 0.015, 1.0), (40, 3))
        images = paint(states, [thing], CAMERA)
        items.append(make_fingerprint(name, states, images, np.zeros((40, 2)), centre=thing.pose))
    moved = Thing(0, (0.50, 0.0, 1.6))
    states = random.normal(moved.pose, (0.005, 0.005, 0.5), (15, 3))
    red, blue = Matcher(None, items, BY_PIXELS).match(states, paint(states, [moved], CAMERA, seed=1))
    assert red.value.min() > 0.5 > blue.value.max()
    middle = np.median(red.pose, axis=0)
    np.testing.assert_allclose(middle[:2], moved.pose[:2], atol=0.006)
    assert middle[2] == pytest.approx(1.6, abs=0.3)


def test_pixels_are_means_of_the_image_in_colours_from_0_to_1():
    grey = np.zeros((1, 60, 60, 3), np.uint8)
    other = grey.copy()
    other[0, 1:2, :4] = 255  # half of two pixels of the small picture
    items = [make_fingerprint(f"object-{i}", np.zeros((1, 3)), images) for i, images in enumerate((grey, other))]
    assert PIXELS == 30
    assert Matcher(None, items, BY_PIXELS).threshold == pytest.approx(math.sqrt(2 * 3 * 0.25), rel=0.01)


def test_what_is_said_has_the_documented_types():
    matches = Matcher(ImageLatents(), [FIRST], LATENTS).match(np.zeros((2, 3)), random_images(2))[0]
    assert (matches.view.dtype, matches.distance.dtype) == (np.int32, np.float32)
    assert (matches.value.dtype, matches.pose.dtype) == (np.float32, np.float64)
    assert matches.pose.shape == (2, 3)
