"""Measurement model: most similar stored view, its distance and the implied pose."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from embodied_active_learning.config import Config, IdentificationConfig
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.geometry import pose_distance, transform_poses
from embodied_active_learning.objects.fingerprint import OBJECT, Fingerprint
from embodied_active_learning.objects.matching import PIXEL_SIDE, Matcher
from painted_table import Thing, paint

LATENTS = IdentificationConfig()
BY_PIXELS = IdentificationConfig(features="pixels")
CAMERA = Config.from_dict({"camera": {"width": 45, "height": 45}}).camera
RED, BLUE = Thing(0, (0.42, -0.05, 0.6)), Thing(1, (0.53, 0.06, -1.0))
POSES = st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-math.pi, math.pi)).map(np.array)


class ImageLatents:
    """A model whose latent depends on the image only."""

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
    """A model whose latent depends on image and state."""

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
    """Return a fingerprint with given latents (V, L) and black images."""
    return make_fingerprint(name, np.zeros((len(latents), 3)), np.zeros((len(latents), 45, 45, 3), np.uint8), latents)


FIRST, SECOND = random_fingerprint("object-1", 6, 1), random_fingerprint("object-2", 4, 2)


@pytest.mark.parametrize("settings_", [LATENTS, BY_PIXELS])
def test_stored_view_matches_itself(settings_):
    matcher = Matcher(ImageLatents(), [FIRST, SECOND], settings_)
    for index, item in enumerate((FIRST, SECOND)):
        own = matcher.match(item.states, item.images)[index]
        np.testing.assert_array_equal(own.view, np.arange(len(item.states)))
        np.testing.assert_allclose(own.distance, 0.0, atol=1e-3)
        np.testing.assert_allclose(own.value, 0.5 + 0.5 * math.tanh(1.0), atol=1e-3)
        np.testing.assert_allclose(own.pose, np.tile(item.centre, (len(item.states), 1)), atol=1e-12)


def test_other_fingerprints_views_have_value_below_half():
    matcher = Matcher(ImageLatents(), [FIRST, SECOND], LATENTS)
    values = np.concatenate(
        [matcher.match(FIRST.states, FIRST.images)[1].value, matcher.match(*states_of(SECOND))[0].value]
    )
    assert values.max() == pytest.approx(0.5, abs=1e-4)
    assert np.sum(values > 0.499) == 2  # the pair of views with the smallest distance


def states_of(item):
    return item.states, item.images


def test_threshold_is_smallest_distance_between_fingerprints():
    one, other, third = [[0, 0], [0, 1]], [[3, 5], [3, 9]], [[-10, 1], [-10, 0.5]]
    matcher = Matcher(
        ImageLatents(), [from_latents(f"object-{i}", x) for i, x in enumerate((one, other, third))], LATENTS
    )
    assert matcher.threshold == pytest.approx(5.0)
    assert matcher.largest == pytest.approx(math.hypot(13, 8.5))


def test_single_fingerprint_threshold_uses_own_views():
    matcher = Matcher(ImageLatents(), [from_latents("object-1", [[0, 0], [0, 3], [8, 3]])], LATENTS)
    assert matcher.threshold == pytest.approx(3.0)
    assert matcher.largest == pytest.approx(math.hypot(8, 3))


def test_value_decreases_through_half_at_threshold():
    matcher = Matcher(
        ImageLatents(), [from_latents("object-1", [[0.0]]), from_latents("object-2", [[2.0], [7.0]])], LATENTS
    )
    # Threshold 2, largest distance 7: widths are 2 below and 2 * 7 - 2 above the threshold.
    distances = np.array([0.0, 1.0, 2.0, 8.0, 14.0])
    expected = 0.5 + 0.5 * np.tanh([1.0, 0.5, 0.0, -0.5, -1.0])
    np.testing.assert_allclose(matcher.value(distances), expected, atol=1e-6)
    assert np.all(np.diff(matcher.value(np.linspace(0.0, 30.0, 300))) < 0.0)
    assert np.all(matcher.value(np.linspace(0.0, 30.0, 300)) > 0.0)


def test_value_is_finite_for_equal_fingerprints():
    matcher = Matcher(ImageLatents(), [from_latents("object-1", [[1.0]]), from_latents("object-2", [[1.0]])], LATENTS)
    values = matcher.value(np.array([0.0, 1e-12, 1.0, 100.0]))
    assert np.all((values >= 0.0) & (values <= 1.0))
    assert values[0] == pytest.approx(0.88, abs=0.01)


def test_single_view_of_single_fingerprint_is_rejected():
    """Two fingerprints with one view each are valid."""
    one, other = (random_fingerprint(f"object-{seed}", 1, seed) for seed in (1, 2))
    with pytest.raises(ObservationError, match="the only fingerprint has a single view"):
        Matcher(ImageLatents(), [one], LATENTS)
    assert Matcher(ImageLatents(), [one, other], LATENTS).match(*states_of(one))[0].value[0] > 0.87


def test_image_is_encoded_at_stored_state():
    model, at = StateLatents(), np.array([[0.9, 0.0, 0.0]])
    items = [FIRST, SECOND]
    found = Matcher(model, items, LATENTS).match(at, random_images(1, 9))
    for item, matches in zip(items, found):
        latent = model.of_image(random_images(1, 9)[0]) + item.states[:, :1]
        distances = np.linalg.norm(latent - item.latent_means, axis=1)
        assert matches.view[0] == distances.argmin()
        assert matches.distance[0] == pytest.approx(distances.min(), rel=1e-5)


@given(POSES, st.integers(0, 2**31 - 1))
def test_pose_of_moved_object_is_exact(goal, seed):
    """The camera moves with the object, so the images are identical."""
    origin = FIRST.centre
    order = np.random.default_rng(seed).permutation(len(FIRST.states))
    states = transform_poses(FIRST.states[order], origin, goal)
    matches = Matcher(ImageLatents(), [FIRST, SECOND], LATENTS).match(states, FIRST.images[order])[0]
    np.testing.assert_array_equal(matches.view, order)
    distance, turn = pose_distance(matches.pose, goal)
    assert distance.max() < 1e-9
    assert turn.max() < 1e-9


@pytest.mark.parametrize("settings_", [LATENTS, BY_PIXELS])
def test_image_encoded_once_or_never_for_pixels(settings_):
    model = ImageLatents()
    matcher = Matcher(model, [FIRST, SECOND], settings_)
    assert model.features == model.pairs == 0
    found = matcher.match(np.zeros((3, 3)), random_images(3))
    assert [matches.view.shape for matches in found] == [(3,), (3,)]
    assert (model.features, model.pairs) == ((3, 3 * 10) if settings_ is LATENTS else (0, 0))


def test_pixel_features_need_no_model():
    """Two things of different colours are distinguished and located by their pixels alone."""
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


def test_pixel_features_are_area_means():
    grey = np.zeros((1, 60, 60, 3), np.uint8)
    other = grey.copy()
    other[0, 1:2, :4] = 255  # half of two pixels of the downscaled image
    items = [make_fingerprint(f"object-{i}", np.zeros((1, 3)), images) for i, images in enumerate((grey, other))]
    assert PIXEL_SIDE == 30
    assert Matcher(None, items, BY_PIXELS).threshold == pytest.approx(math.sqrt(2 * 3 * 0.25), rel=0.01)


def test_matches_have_documented_dtypes():
    matches = Matcher(ImageLatents(), [FIRST], LATENTS).match(np.zeros((2, 3)), random_images(2))[0]
    assert (matches.view.dtype, matches.distance.dtype) == (np.int32, np.float32)
    assert (matches.value.dtype, matches.pose.dtype) == (np.float32, np.float64)
    assert matches.pose.shape == (2, 3)
