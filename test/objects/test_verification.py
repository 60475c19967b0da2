"""Views of a candidate agree with a fingerprint if its model explains them as well as the fingerprint's own views."""

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
    """States (N, 3) around a pose, all of them within the distance from which views are compared."""
    random = np.random.default_rng(seed)
    distance, angle = spread * np.sqrt(random.uniform(0, 1, count)), random.uniform(-math.pi, math.pi, count)
    turn = random.uniform(-0.5, 0.5, count)
    return np.asarray(pose) + np.stack((distance * np.cos(angle), distance * np.sin(angle), turn), axis=1)


def compare(name, things, pose=PLACE, settings=SETTINGS, states=None):
    """What views around a pose of a table with things on it say about a fingerprint being at that pose."""
    states = around(pose) if states is None else states
    return verifier(name, settings).compare(np.asarray(pose), states, paint(states, things, CAMERA, seed=5))


def moved(pose, x, y, yaw):
    return np.add(pose, (x, y, yaw))


def at(thing, pose=PLACE, **fields):
    return thing._replace(pose=tuple(pose), **fields)


@pytest.mark.parametrize("index", [0, 1, 2])
def test_own_views_have_no_mismatch(index):
    fingerprint = LEARNED.fingerprints[index]
    check = verifier(fingerprint.name, replace(SETTINGS, views=1000, view_distance=0.1))
    comparison = check.compare(fingerprint.centre, fingerprint.states, fingerprint.images)
    assert len(comparison.views) == len(fingerprint.states)
    assert comparison.typical == pytest.approx(0.0, abs=1e-9)
    assert np.abs(comparison.residual).max() < LIMIT


@pytest.mark.parametrize("pose", [RED.pose, PLACE, (0.60, 0.12, -0.5), (0.35, 0.0, 2.6)])
def test_the_object_agrees_wherever_it_stands_and_however_it_is_turned(pose):
    comparison = compare("object-1", [at(RED, pose)], pose)
    assert len(comparison.residual) > 15
    assert np.abs(comparison.residual).max() < LIMIT


@pytest.mark.parametrize("other", [BLUE, GREEN])
def test_another_object_known_or_not_is_explained_worse(other):
    assert compare("object-1", [at(other)]).residual.min() > LIMIT


def test_a_bare_table_is_explained_too_well_for_an_object():
    assert compare("object-1", []).residual.max() < -LIMIT


def test_an_object_is_explained_worse_by_a_blank():
    assert compare("blank-1", [at(RED)]).residual.min() > LIMIT


@pytest.mark.parametrize("things", [[], [Thing(1, (0.565, -0.03, 0.0), 0.015)]])
def test_a_bare_table_agrees_with_a_blank_though_something_is_to_be_seen_at_the_edge(things):
    assert np.abs(compare("blank-1", things).residual).max() < LIMIT


def test_the_object_turned_or_moved_away_from_the_candidate_is_explained_worse():
    turned = at(RED, moved(PLACE, 0.0, 0.0, 2.0))
    aside = at(RED, moved(PLACE, 0.015, 0.0, 0.0))
    assert compare("object-1", [turned]).typical > LIMIT
    assert compare("object-1", [aside]).typical > LIMIT


def test_what_stands_beyond_the_objects_radius_does_not_count():
    near, far = (at(BLUE, moved(PLACE, away, 0.0, 0.0), radius=0.015) for away in (0.03, 0.064))
    alone = compare("object-1", [at(RED)])
    np.testing.assert_allclose(compare("object-1", [at(RED), far]).residual, alone.residual, atol=0.005)
    assert compare("object-1", [at(RED), near]).typical > LIMIT
    wide = replace(SETTINGS, object_radius=0.08)
    assert compare("object-1", [at(RED), far], settings=wide).typical > alone.typical + 0.03


def test_pixels_are_compared_with_the_stored_view_from_next_to_it_and_need_no_model():
    settings = replace(SETTINGS, features="pixels")
    itself, other = (compare("object-1", [at(thing)], settings=settings) for thing in (RED, BLUE))
    assert itself.typical == pytest.approx(0.0, abs=LIMIT)
    assert other.typical > LIMIT
    fingerprint = LEARNED.fingerprints[0]
    views = range(0, 50, 7)
    states = move(fingerprint.states[views], fingerprint.centre, PLACE)
    same = verifier("object-1", settings).compare(PLACE, states, fingerprint.images[views])
    assert same.residual.max() < -0.1  # the very same images: no error at all


def test_without_views_the_mismatch_is_infinite():
    comparison = compare("object-1", [at(RED)], states=around(moved(PLACE, 0.1, 0.0, 0.0)))
    assert len(comparison.views) == len(comparison.residual) == 0
    assert math.isinf(comparison.typical)
    assert compare("object-1", [at(RED)], states=np.empty((0, 3))).typical == math.inf


def test_typical_is_the_median():
    assert Comparison(np.arange(3), np.array([5.0, -1.0, 0.5])).typical == 0.5


def test_compared_are_the_views_from_next_to_the_candidate():
    offsets = np.array([0.0, 0.029, 0.031, 0.2, 0.01])
    states = PLACE + offsets[:, None] * [0.6, -0.8, 0.0]
    assert sorted(compare("object-1", [at(RED)], states=states).views) == [0, 1, 4]
    near = compare("object-1", [at(RED)], states=states, settings=replace(SETTINGS, view_distance=0.02))
    assert sorted(near.views) == [0, 4]


def test_not_compared_are_views_that_the_camera_could_not_have_over_the_learned_object():
    """The yaw of the workspace ends at 2 rad: from the learned pose the camera turns by 1.4 rad one way at most."""
    pose = np.array([0.5, 0.0, 0.0])
    states = np.array([[0.5, 0.0, turn] for turn in (0.0, 1.3, 1.5, -2.5, -2.7, 3.0)])
    assert compare("object-1", [at(RED, pose)], pose, states=states).views.tolist() == [0, 1, 3]
    # The learned object stands 8 cm from the border of the workspace, so all places around it count.
    assert len(compare("object-1", [at(RED, pose)], pose, states=around(pose, spread=0.029)).views) == 25


def test_of_an_object_at_the_border_views_from_beyond_it_are_not_compared():
    found = learn((Thing(0, (0.33, 0.0, 0.0)),))
    pose = np.array([0.5, 0.0, 0.0])
    states = np.array([pose, moved(pose, -0.004, 0, 0), moved(pose, -0.006, 0, 0), moved(pose, 0.02, 0, 0)])
    check = verifier("object-1", found=found)
    assert check.compare(pose, states, paint(states, [at(RED, pose)], CAMERA)).views.tolist() == [
        0,
        1,
        3,
    ]  # the nearest first


def test_of_many_views_the_nearest_are_compared():
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
def test_compared_are_the_pixels_that_show_the_table_within_the_radius(radius, seed):
    """By a point of the table for every pixel, in double precision; discs reach over the images' borders."""
    random, camera = np.random.default_rng(seed), LEARNED.config.camera
    rule = replace(SETTINGS, features="pixels", object_radius=radius, view_distance=0.09)
    fingerprint = LEARNED.fingerprints[0]
    states = PLACE + random.uniform((-0.06, -0.06, -0.5), (0.06, 0.06, 0.5), (12, 3))
    images = random.integers(0, 256, (12, 45, 45, 3), dtype=np.uint8)
    # One view twice: its own error is 0, and it is what each image is compared with.
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


def test_mismatch_is_by_how_much_the_error_is_larger():
    """Of a blank only the error counts: six grey levels more of noise on the table are as much of residual."""
    states = around(PLACE)
    check = verifier("blank-1")
    residuals = [check.compare(PLACE, states, paint(states, [], CAMERA, noise)).typical for noise in (3.0, 9.0)]
    assert residuals[0] == pytest.approx(0.0, abs=0.002)
    assert residuals[1] == pytest.approx(6.0 / 255.0, abs=0.002)


def test_being_unsure_counts_as_a_mismatch_by_the_predicted_standard_deviation():
    """A model that is twice as unsure about the candidate as about its own views, and paints it as well."""

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


def test_views_that_are_compared_come_from_where_the_learned_object_would_show_the_same():
    """What is asked of the model is the learned table: it is never told where the candidate stands."""

    class Spy(PaintedModel):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            self.told = []

        def encode(self, states, images):
            self.told.append(states)
            return super().encode(states, images)

        def decode(self, latents, states):
            self.told.append(states)
            return super().decode(latents, states)

    model = Spy(LEARNED.config, LEARNED.weights)
    check = Verifier(model, LEARNED.fingerprints[0], LEARNED.config, SETTINGS)
    states = around(PLACE)
    model.told.clear()
    views = check.compare(PLACE, states, paint(states, [at(RED)], CAMERA)).views
    expected = move(states[views], PLACE, np.array(RED.pose))
    assert len(model.told) == 2
    for told in model.told:
        np.testing.assert_allclose(told, expected, atol=1e-9)


def test_the_camera_is_the_one_that_the_model_was_trained_with():
    """Seen from twice the height, the table within the object's radius is a quarter of the pixels."""
    config = Config.from_dict({**LEARNED.config.to_dict(), "camera": {"width": 45, "height": 45, "distance": 0.6}})
    check = Verifier(None, LEARNED.fingerprints[0], config, replace(SETTINGS, features="pixels"))
    states = PLACE[None]
    images = np.zeros((1, 45, 45, 3), np.uint8)
    plain = check.compare(PLACE, states, images).residual
    images[0, :, :12] = 255  # outside of the quarter
    assert check.compare(PLACE, states, images).residual == pytest.approx(plain)
    images[0, 20:25, 20:25] = 255
    assert check.compare(PLACE, states, images).residual != pytest.approx(plain)
