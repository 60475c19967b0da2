"""Comparison of candidate views with a fingerprint's own views."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from embodied_active_learning.config import Config, IdentificationConfig
from embodied_active_learning.geometry import move, table_points
from embodied_active_learning.objects.verification import Comparison, Verifier
from painted_table import PaintedModel, Thing, learn, paint

SETTINGS = IdentificationConfig(residual_limit=0.065, object_radius=0.045, view_distance=0.03, views=30)
LIMIT = SETTINGS.residual_limit
RED, BLUE, GREEN = Thing(0, (0.40, -0.07, 0.6)), Thing(1, (0.54, 0.06, -1.0)), Thing(2, (0.45, 0.05, 0.0))
BARE = (0.36, 0.12)
LEARNED = learn((RED, BLUE), BARE)
CAMERA = LEARNED.config.camera
PLACE = np.array([0.50, -0.03, 1.1])


def verifier(name, settings=SETTINGS, found=LEARNED):
    fingerprint = next(item for item in found.fingerprints if item.name == name)
    model = None if settings.features == "pixels" else PaintedModel(found.config, found.weights)
    return Verifier(model, fingerprint, found.config, settings)


def around(pose, count=25, spread=0.01, seed=7):
    """Return states (N, 3) around a pose, within the view distance."""
    random = np.random.default_rng(seed)
    distance, angle = spread * np.sqrt(random.uniform(0, 1, count)), random.uniform(-math.pi, math.pi, count)
    turn = random.uniform(-0.5, 0.5, count)
    return np.asarray(pose) + np.stack((distance * np.cos(angle), distance * np.sin(angle), turn), axis=1)


def compare(name, things, pose=PLACE, settings=SETTINGS, states=None):
    """Compare views around a pose, of a table with things on it, with a fingerprint."""
    states = around(pose) if states is None else states
    return verifier(name, settings).compare(np.asarray(pose), states, paint(states, things, CAMERA, seed=5))


def moved(pose, x, y, yaw):
    return np.add(pose, (x, y, yaw))


def at(thing, pose=PLACE, **fields):
    return thing._replace(pose=tuple(pose), **fields)


@pytest.mark.parametrize("index", [0, 1, 2])
def test_own_views_have_zero_residual(index):
    fingerprint = LEARNED.fingerprints[index]
    check = verifier(fingerprint.name, replace(SETTINGS, views=1000, view_distance=0.1))
    comparison = check.compare(fingerprint.centre, fingerprint.states, fingerprint.images)
    assert len(comparison.views) == len(fingerprint.states)
    assert comparison.median == pytest.approx(0.0, abs=1e-9)
    assert np.abs(comparison.residual).max() < LIMIT


@pytest.mark.parametrize("pose", [RED.pose, PLACE, (0.60, 0.12, -0.5), (0.35, 0.0, 2.6)])
def test_object_agrees_at_any_pose(pose):
    comparison = compare("object-1", [at(RED, pose)], pose)
    assert len(comparison.residual) > 15
    assert np.abs(comparison.residual).max() < LIMIT


@pytest.mark.parametrize("other", [BLUE, GREEN])
def test_other_object_has_larger_residual(other):
    assert compare("object-1", [at(other)]).residual.min() > LIMIT


def test_bare_table_has_negative_residual_for_object():
    assert compare("object-1", []).residual.max() < -LIMIT


def test_object_has_larger_residual_for_blank():
    assert compare("blank-1", [at(RED)]).residual.min() > LIMIT


@pytest.mark.parametrize("things", [[], [Thing(1, (0.565, -0.03, 0.0), 0.015)]])
def test_bare_table_agrees_with_blank(things):
    """Also if an object is visible at the edge of the image."""
    assert np.abs(compare("blank-1", things).residual).max() < LIMIT


def test_misplaced_object_has_larger_residual():
    turned = at(RED, moved(PLACE, 0.0, 0.0, 2.0))
    aside = at(RED, moved(PLACE, 0.015, 0.0, 0.0))
    assert compare("object-1", [turned]).median > LIMIT
    assert compare("object-1", [aside]).median > LIMIT


def test_residual_ignores_pixels_beyond_object_radius():
    near, far = (at(BLUE, moved(PLACE, away, 0.0, 0.0), radius=0.015) for away in (0.03, 0.064))
    alone = compare("object-1", [at(RED)])
    np.testing.assert_allclose(compare("object-1", [at(RED), far]).residual, alone.residual, atol=0.005)
    assert compare("object-1", [at(RED), near]).median > LIMIT
    wide = replace(SETTINGS, object_radius=0.08)
    assert compare("object-1", [at(RED), far], settings=wide).median > alone.median + 0.03


def test_pixel_comparison_uses_nearest_stored_view():
    settings = replace(SETTINGS, features="pixels")
    itself, other = (compare("object-1", [at(thing)], settings=settings) for thing in (RED, BLUE))
    assert itself.median == pytest.approx(0.0, abs=LIMIT)
    assert other.median > LIMIT
    fingerprint = LEARNED.fingerprints[0]
    views = range(0, 50, 7)
    states = move(fingerprint.states[views], fingerprint.centre, PLACE)
    same = verifier("object-1", settings).compare(PLACE, states, fingerprint.images[views])
    assert same.residual.max() < -0.1  # identical images have no error


def test_residual_without_views_is_infinite():
    comparison = compare("object-1", [at(RED)], states=around(moved(PLACE, 0.1, 0.0, 0.0)))
    assert len(comparison.views) == len(comparison.residual) == 0
    assert math.isinf(comparison.median)
    assert compare("object-1", [at(RED)], states=np.empty((0, 3))).median == math.inf


def test_comparison_median():
    assert Comparison(np.arange(3), np.array([5.0, -1.0, 0.5])).median == 0.5


def test_views_are_limited_by_view_distance():
    offsets = np.array([0.0, 0.029, 0.031, 0.2, 0.01])
    states = PLACE + offsets[:, None] * [0.6, -0.8, 0.0]
    assert sorted(compare("object-1", [at(RED)], states=states).views) == [0, 1, 4]
    near = compare("object-1", [at(RED)], states=states, settings=replace(SETTINGS, view_distance=0.02))
    assert sorted(near.views) == [0, 4]


def test_views_unreachable_at_learned_object_are_excluded():
    """The workspace ends at a yaw of 2 rad, 1.4 rad from the learned pose."""
    pose = np.array([0.5, 0.0, 0.0])
    states = np.array([[0.5, 0.0, turn] for turn in (0.0, 1.3, 1.5, -2.5, -2.7, 3.0)])
    assert compare("object-1", [at(RED, pose)], pose, states=states).views.tolist() == [0, 1, 3]
    # The learned object is 8 cm from the border of the workspace, so all views around it can be compared.
    assert len(compare("object-1", [at(RED, pose)], pose, states=around(pose, spread=0.029)).views) == 25


def test_views_beyond_border_of_learned_object_are_excluded():
    found = learn((Thing(0, (0.33, 0.0, 0.0)),))
    pose = np.array([0.5, 0.0, 0.0])
    states = np.array([pose, moved(pose, -0.004, 0, 0), moved(pose, -0.006, 0, 0), moved(pose, 0.02, 0, 0)])
    check = verifier("object-1", found=found)
    assert check.compare(pose, states, paint(states, [at(RED, pose)], CAMERA)).views.tolist() == [
        0,
        1,
        3,
    ]  # the nearest first


def test_nearest_views_are_compared_first():
    states = around(PLACE, 40)
    some = compare("object-1", [at(RED)], states=states, settings=replace(SETTINGS, views=7))
    distances = np.hypot(*(states - PLACE).T[:2])
    assert set(some.views) == set(np.argsort(distances)[:7])
    every = compare("object-1", [at(RED)], states=states, settings=replace(SETTINGS, views=40))
    assert len(every.views) == 40
    expected = dict(zip(every.views, every.residual))
    np.testing.assert_allclose(some.residual, [expected[view] for view in some.views], atol=1e-12)


@pytest.mark.parametrize("radius", [0.005, 0.045, 0.08])
@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**31 - 1))
def test_disc_contains_pixels_within_object_radius(radius, seed):
    """Compare with table points computed for every pixel; discs extend over the image borders."""
    random, camera = np.random.default_rng(seed), LEARNED.config.camera
    rule = replace(SETTINGS, features="pixels", object_radius=radius, view_distance=0.09)
    fingerprint = LEARNED.fingerprints[0]
    states = PLACE + random.uniform((-0.06, -0.06, -0.5), (0.06, 0.06, 0.5), (12, 3))
    images = random.integers(0, 256, (12, 45, 45, 3), dtype=np.uint8)
    # One view twice: its own error is 0, and each image is compared with it.
    arrays = ("states", "images", "latent_means", "latent_stds")
    only = replace(fingerprint, **{name: getattr(fingerprint, name)[[7, 7]] for name in arrays})
    found = Verifier(None, only, LEARNED.config, rule).compare(PLACE, states, images)
    assert len(found.views) > 0
    for view, residual in zip(found.views, found.residual):
        points = table_points(states[view], *np.mgrid[0:45, 0:45], camera)
        inside = np.linalg.norm(points - PLACE[:2], axis=2) < radius
        difference = (images[view] / 255.0 - only.images[0] / 255.0)[inside]
        expected = math.sqrt(np.square(difference).mean()) if inside.any() else 0.0
        assert residual == pytest.approx(expected, abs=1e-6)


def test_residual_is_error_increase():
    """For a blank only the RMS error counts: six grey levels of additional noise give that residual."""
    states = around(PLACE)
    check = verifier("blank-1")
    residuals = [check.compare(PLACE, states, paint(states, [], CAMERA, noise)).median for noise in (3.0, 9.0)]
    assert residuals[0] == pytest.approx(0.0, abs=0.002)
    assert residuals[1] == pytest.approx(6.0 / 255.0, abs=0.002)


def test_residual_includes_predicted_std():
    """A model that predicts twice the standard deviation for the candidate, with the same reconstruction."""

    class Unsure(PaintedModel):
        factor = 1.0

        def decode(self, latents, states):
            images, std = super().decode(latents, states)
            return images, std * self.factor

    model = Unsure(LEARNED.config, LEARNED.weights)
    check = Verifier(model, LEARNED.fingerprints[0], LEARNED.config, SETTINGS)
    states = around(PLACE)
    images = paint(states, [at(RED)], CAMERA, seed=5)
    before = check.compare(PLACE, states, images).residual
    model.factor = 2.0
    np.testing.assert_allclose(check.compare(PLACE, states, images).residual, before + model.FAIR, atol=1e-6)


def test_model_is_queried_at_learned_object():
    """The model is queried at the learned object's poses only, never at the candidate's."""

    class Spy(PaintedModel):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            self.queried = []

        def encode(self, states, images):
            self.queried.append(states)
            return super().encode(states, images)

        def decode(self, latents, states):
            self.queried.append(states)
            return super().decode(latents, states)

    model = Spy(LEARNED.config, LEARNED.weights)
    check = Verifier(model, LEARNED.fingerprints[0], LEARNED.config, SETTINGS)
    states = around(PLACE)
    model.queried.clear()
    views = check.compare(PLACE, states, paint(states, [at(RED)], CAMERA)).views
    expected = move(states[views], PLACE, np.array(RED.pose))
    assert len(model.queried) == 2
    for states in model.queried:
        np.testing.assert_allclose(states, expected, atol=1e-9)


def test_comparison_uses_training_camera():
    """At twice the height, the object's radius covers a quarter of the pixels."""
    config = Config.from_dict({**LEARNED.config.to_dict(), "camera": {"width": 45, "height": 45, "distance": 0.6}})
    check = Verifier(None, LEARNED.fingerprints[0], config, replace(SETTINGS, features="pixels"))
    states = PLACE[None]
    images = np.zeros((1, 45, 45, 3), np.uint8)
    plain = check.compare(PLACE, states, images).residual
    images[0, :, :12] = 255  # outside of the quarter
    assert check.compare(PLACE, states, images).residual == pytest.approx(plain)
    images[0, 20:25, 20:25] = 255
    assert check.compare(PLACE, states, images).residual != pytest.approx(plain)
