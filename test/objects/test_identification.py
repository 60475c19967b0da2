"""Painted things are found where they were put, as often as they are there, and nothing else is."""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from unittest import mock

import numpy as np
import pytest

from embodied_active_learning.config import CameraConfig, IdentificationConfig
from embodied_active_learning.errors import ConfigError
from embodied_active_learning.geometry import pose_distance
from embodied_active_learning.objects import identification
from embodied_active_learning.objects.fingerprint import BLANK, OBJECT
from embodied_active_learning.objects.identification import Identification
from painted_table import PaintedModel, Thing, learn, paint, random_states

SETTINGS = IdentificationConfig(
    cells=(20, 20, 12),
    candidates=12,
    separation=0.06,
    min_belief=0.5,
    residual_limit=0.065,
    agreement_distance=0.02,
    min_agreement=0.6,
    object_radius=0.045,
    view_distance=0.03,
    views=20,
    min_views=5,
)
RED, BLUE, GREEN = Thing(0, (0.40, -0.07, 0.6)), Thing(1, (0.54, 0.06, -1.0)), Thing(2, (0.45, 0.05, 0.0))
BARE = (0.36, 0.12)
LEARNED = learn((RED, BLUE), BARE)
WORKSPACE, CAMERA = LEARNED.config.workspace.box(), LEARNED.config.camera
# Where things are put in the tests, and where none is: far enough apart not to be in one view.
HERE, THERE, NOWHERE = (0.56, -0.08, 0.9), (0.38, 0.08, -0.4), (0.57, 0.10, 0.0)


def put(thing, pose):
    return thing._replace(pose=pose)


TWO = (put(RED, HERE), put(BLUE, THERE))


@functools.lru_cache(maxsize=None)
def stream(things=TWO, noise=3.0, around=(HERE, THERE, NOWHERE)):
    """States all over the workspace, more of them around where things may be, and what is seen from them."""
    random = np.random.default_rng(3)
    places = [random.uniform(np.subtract(pose, 0.03), np.add(pose, 0.03), (40, 3)) for pose in around]
    states = WORKSPACE.clip(np.concatenate([random_states(WORKSPACE, 60, seed=3), *places]))
    states[:, 2] = random.permutation(np.linspace(-2.0, 2.0, len(states)))
    return states, paint(states, things, CAMERA, noise, seed=9)


def make_identification(sets=(LEARNED,), settings=SETTINGS, camera=CAMERA):
    with mock.patch.object(identification, "TrainedModel", PaintedModel):
        return Identification(sets, WORKSPACE, camera, settings)


def identify(images, sets=(LEARNED,), settings=SETTINGS, observed=None):
    """The decisions on a stream, or those on it after a part of it, or another one, was observed."""
    looking = make_identification(sets, settings)
    looking.observe(*(images if observed is None else observed))
    return looking.decide(*images)


@functools.lru_cache(maxsize=None)
def decide(things=TWO, **settings):
    """The decisions on things that were put on the table, with settings other than the defaults."""
    return tuple(identify(stream(things), settings=replace(SETTINGS, **settings)))


def of(decisions, name, session="learned"):
    return [item for item in decisions if (item.session, item.fingerprint) == (session, name)]


def assert_found(decisions, poses):
    """All are found, at these poses in whatever order, within 1 cm and 20 degrees, and numbered in their own order."""
    assert [item.instance for item in decisions] == list(range(1, len(poses) + 1))
    for item in decisions:
        assert item.found
        assert item.confidence >= SETTINGS.min_agreement
    for pose in poses:
        errors = [pose_distance(item.pose, np.array(pose)) for item in decisions]
        assert any(distance < 0.01 and turn < math.radians(20.0) for distance, turn in errors)


def assert_not_found(decisions):
    """One decision says so, and why."""
    assert len(decisions) == 1
    assert not decisions[0].found
    assert decisions[0].instance == 0
    assert decisions[0].reason


def test_things_that_were_moved_and_turned_are_found_where_they_are():
    assert_found(of(decide(), "object-1"), [HERE])
    assert_found(of(decide(), "object-2"), [THERE])


def test_a_decision_says_what_it_was_made_by():
    red, blue, blank = decide()
    assert [item.fingerprint for item in (red, blue, blank)] == ["object-1", "object-2", "blank-1"]
    assert [item.kind for item in (red, blue, blank)] == [OBJECT, OBJECT, BLANK]
    for item in (red, blue, blank):
        agreeing = round(item.confidence * item.views)
        assert item.reason == f"{agreeing} of {item.views} views agree"
        assert SETTINGS.min_views <= item.views <= SETTINGS.views
        assert abs(item.residual) < SETTINGS.residual_limit
        assert 0.0 < item.belief_mean < 1.0
        assert 0.0 < item.belief_std < math.sqrt(2.0)


@pytest.mark.parametrize("pose", [(0.615, 0.14, 1.5), (0.33, -0.145, -0.7)])
def test_a_thing_next_to_the_border_is_found(pose):
    assert_found(of(identify(stream((put(RED, pose),), around=(pose, pose, pose))), "object-1"), [pose])


def test_a_thing_is_found_at_the_yaw_that_its_views_agree_with_though_another_is_believed_more():
    looking = make_identification()
    looking.observe(*stream())
    wrong = np.array([(*HERE[:2], HERE[2] + 2.5)] * 20)
    looking.sought[0].grid.update(wrong, np.ones(20), np.ones(20))
    pose, _, _, _ = looking.sought[0].grid.peaks(SETTINGS.separation, 1)[0]
    _, turn = pose_distance(pose, wrong[0])
    assert turn < 0.5
    assert_found(of(looking.decide(*stream()), "object-1"), [HERE])


def test_every_instance_of_a_thing_is_found_the_highest_belief_first():
    decisions = decide((put(RED, HERE), put(RED, THERE)))
    assert_found(of(decisions, "object-1"), [HERE, THERE])
    beliefs = [item.belief_mean for item in of(decisions, "object-1")]
    assert beliefs == sorted(beliefs, reverse=True)
    assert_not_found(of(decisions, "object-2"))


def test_a_thing_that_is_absent_is_not_found_on_another_one():
    decisions = decide((put(RED, HERE),))
    assert_found(of(decisions, "object-1"), [HERE])
    assert_not_found(of(decisions, "object-2"))


@pytest.mark.parametrize("things", [(), (put(GREEN, HERE),)])
def test_nothing_but_blank_is_found_on_a_bare_table_and_where_all_is_unknown(things):
    decisions = decide(things)
    assert [item.fingerprint for item in decisions if item.found] == ["blank-1"]


def test_every_fingerprint_has_a_decision_also_when_its_belief_is_highest_beyond_the_workspace():
    """What was looked for in vain all over the workspace is believed to be in the margin around it, if anywhere."""
    looking = make_identification()
    poses = np.array([[x, y, 0.0] for x in np.linspace(0.35, 0.6, 6) for y in np.linspace(-0.12, 0.12, 6)])
    for item in looking.sought:
        item.grid.update(poses, np.full(36, 0.2), np.ones(36))
        assert not WORKSPACE.contains(highest(item.grid))
    decisions = looking.decide(np.empty((0, 3)), np.empty((0, 45, 45, 3), np.uint8))
    assert [item.fingerprint for item in decisions] == ["object-1", "object-2", "blank-1"]
    for item in decisions:
        assert_not_found([item])


def highest(grid):
    x, y, _ = np.unravel_index(grid.mean.argmax(), grid.mean.shape)
    return [grid.x[x], grid.y[y], 0.0]


def test_blank_is_found_once_only_and_where_nothing_is():
    (blank,) = of(decide(), "blank-1")
    assert (blank.found, blank.instance) == (True, 1)
    assert blank.pose[2] == LEARNED.fingerprints[-1].centre[2]  # it has no yaw of its own
    for thing in TWO:
        assert np.hypot(*(blank.pose[:2] - thing.pose[:2])) > thing.radius + 0.02


def test_blank_is_decided_by_the_same_limit_as_objects():
    rough = stream((), noise=30.0)
    assert_not_found(of(identify(rough), "blank-1"))
    wide = replace(SETTINGS, residual_limit=0.2)
    assert of(identify(rough, settings=wide), "blank-1")[0].found
    assert_not_found(of(decide(min_views=31), "blank-1"))


def test_views_that_look_different_do_not_agree():
    decisions = decide(residual_limit=0.0)
    assert_not_found(of(decisions, "object-1"))
    assert of(decisions, "object-1")[0].confidence == 0.0
    assert_not_found(of(decisions, "blank-1"))


def test_views_that_point_elsewhere_do_not_agree_but_a_blank_is_in_no_particular_place():
    decisions = decide(agreement_distance=0.001)
    for name in ("object-1", "object-2"):
        assert_not_found(of(decisions, name))
        assert of(decisions, name)[0].reason.endswith("of 20 views point here")
    assert of(decisions, "blank-1")[0].found


STRICT = {"agreement_distance": 0.007, "min_agreement": 0.1}
"""Not all views agree then."""


def test_the_share_of_views_that_must_agree_can_be_set():
    red = of(decide(**STRICT), "object-1")[0]
    assert 0.1 < red.confidence < 0.9
    assert_not_found(of(decide(**{**STRICT, "min_agreement": red.confidence + 0.01}), "object-1"))
    assert of(decide(**{**STRICT, "min_agreement": red.confidence}), "object-1")[0].found


def test_a_thing_that_was_seen_from_too_few_places_is_not_found_and_the_reason_says_so():
    states, images = stream()
    near = np.flatnonzero(np.hypot(*(states[:, :2] - HERE[:2]).T) < 0.045)
    kept = np.setdiff1d(np.arange(len(states)), near)
    closest = near[np.argsort(np.hypot(*(states[near, :2] - HERE[:2]).T))]
    few = np.sort(np.concatenate([kept, closest[:4]]))
    decisions = identify((states[few], images[few]), observed=None)
    red = of(decisions, "object-1")
    assert_not_found(red)
    assert 0 < red[0].views <= 4
    assert red[0].confidence == 0.0
    assert red[0].reason == f"seen from {red[0].views} places only, 5 are needed"
    enough = identify((states[few], images[few]), settings=replace(SETTINGS, min_views=red[0].views))
    assert_found(of(enough, "object-1"), [HERE])


def test_nothing_is_found_before_the_first_image():
    looking = make_identification()
    assert looking.images == 0
    assert looking.sought[0].trace.pose.shape == (0, 3)
    for item in looking.decide(np.empty((0, 3)), np.empty((0, 45, 45, 3), np.uint8)):
        assert_not_found([item])
        assert item.views == 0
        assert math.isinf(item.residual)
        assert item.confidence == 0.0
        assert item.reason == "seen from 0 places only, 5 are needed"


def alike(views=slice(None), name="object-3"):
    """The fingerprint of the red thing once more, or some of its views."""
    red = LEARNED.fingerprints[0]
    arrays = {field: getattr(red, field)[views] for field in ("states", "images", "latent_means", "latent_stds")}
    return replace(red, name=name, **arrays)


def with_fingerprints(*fingerprints):
    return replace(LEARNED, fingerprints=fingerprints)


@pytest.mark.parametrize("believed", [False, True])
def test_of_two_fingerprints_that_claim_a_place_the_surer_has_it_and_not_the_one_that_is_believed_more(believed):
    whole, part, blue = LEARNED.fingerprints[0], alike(slice(0, 25)), LEARNED.fingerprints[1]
    settings, alone = replace(SETTINGS, **STRICT), {}
    for item in (whole, part):
        (alone[item.name],) = of(identify(stream(), [with_fingerprints(item, blue)], settings), item.name)
        assert alone[item.name].found
    surer, other = sorted(alone, key=lambda name: -alone[name].confidence)
    assert alone[surer].confidence > alone[other].confidence
    looking = make_identification([with_fingerprints(blue, part, whole)], settings)
    looking.observe(*stream())
    if believed:
        (sought,) = [item for item in looking.sought if item.fingerprint.name == other]
        sought.grid.update(np.tile(alone[other].pose, (20, 1)), np.ones(20), np.ones(20))
    both = looking.decide(*stream())
    assert of(both, surer)[0].found
    assert_not_found(of(both, other))
    assert of(both, other)[0].reason == f"{surer} fits better there"
    assert (of(both, other)[0].belief_mean > of(both, surer)[0].belief_mean) == believed


def test_two_fingerprints_that_are_equally_sure_do_not_both_claim_a_place():
    decisions = identify(stream(), [with_fingerprints(LEARNED.fingerprints[0], alike(), LEARNED.fingerprints[1])])
    found = [item.fingerprint for item in decisions if item.found]
    assert found in (["object-1", "object-2"], ["object-3", "object-2"])


def test_a_bare_place_next_to_an_object_does_not_take_the_objects_place():
    """What stands out says nothing against the table next to it being bare, nor the other way round."""
    small = RED._replace(radius=0.008)
    bare = np.add(HERE, (-0.055, 0.0, 0.0))  # closer than two objects are taken to lie, and yet nothing is there
    images = stream((put(small, HERE),), around=(HERE, tuple(bare)))
    settings = replace(SETTINGS, **STRICT, separation=0.07)
    looking = make_identification([learn((small, BLUE), BARE)], settings)
    looking.observe(*images)
    blank = looking.sought[-1].grid
    blank.update(np.tile(bare, (20, 1)), np.ones(20), np.ones(20))
    assert np.hypot(*(blank.peaks(0.06, 1)[0][0] - bare)[:2]) < 0.01
    red = of(looking.decide(*images), "object-1")[0]
    assert red.found, red.reason
    assert red.confidence < 1.0


def test_by_belief_found_is_what_the_mean_belief_says():
    decisions = decide(decision="belief")
    for item in decisions:
        assert item.found == (item.belief_mean > 0.5)
        relation = "above" if item.found else "not above"
        assert item.reason == f"belief {item.belief_mean:.2f} {relation} 0.5"
    lower = of(decide(decision="belief", min_belief=0.05), "object-2")
    assert lower[0].found
    assert_not_found(of(decide(decision="belief", min_belief=0.999), "object-1"))


def test_by_belief_a_contested_place_goes_to_the_fingerprint_that_is_believed_more():
    sets = [with_fingerprints(alike(slice(0, 25)), LEARNED.fingerprints[0], LEARNED.fingerprints[1])]
    decisions = identify(stream(), sets, replace(SETTINGS, decision="belief", min_belief=0.3))
    claims = of(decisions, "object-1") + of(decisions, "object-3")
    here = [item for item in claims if np.hypot(*(item.pose[:2] - HERE[:2])) < 0.03]
    assert len(here) == 2
    winner, other = sorted(here, key=lambda item: -item.belief_mean)
    assert winner.belief_mean > other.belief_mean > 0.3
    assert (winner.found, other.found) == (True, False)
    assert other.reason == f"{winner.fingerprint} fits better there"


def test_by_belief_no_views_are_needed():
    states, images = stream()
    looking = make_identification(settings=replace(SETTINGS, decision="belief", min_belief=0.3))
    looking.observe(states, images)
    red = of(looking.decide(states[:0], images[:0]), "object-1")[0]
    assert red.found
    assert red.views == 0


@pytest.mark.parametrize(("key", "value"), [("width", 46), ("height", 44), ("field_of_view", 31.0), ("distance", 0.31)])
def test_images_of_another_camera_are_refused_by_the_key(key, value):
    match = rf"session learned was trained with camera/{key} = .*, the images have {value}"
    with pytest.raises(ConfigError, match=match):
        make_identification(camera=replace(CAMERA, **{key: value}))


def test_a_camera_that_differs_in_nothing_that_is_seen_is_taken():
    assert isinstance(CAMERA, CameraConfig)
    assert len(make_identification(camera=replace(CAMERA, max_age=9.0)).sought) == 3


def test_fingerprints_of_two_sessions_are_found_in_one_stream_each_by_its_own_model():
    reds, greens = learn((RED,), BARE, session="a"), learn((GREEN, BLUE), session="b")
    images = stream((put(RED, HERE), put(GREEN, THERE)))
    together = identify(images, [reds, greens])
    assert_found(of(together, "object-1", "a"), [HERE])
    assert_found(of(together, "object-1", "b"), [THERE])
    assert_not_found(of(together, "object-2", "b"))
    assert [item.session for item in together] == ["a", "a", "b", "b"]
    for sets in ([reds], [greens]):
        for item in identify(images, sets):
            (same,) = of(together, item.fingerprint, item.session)
            np.testing.assert_array_equal(same.pose, item.pose)
            assert (same.found, same.confidence, same.belief_mean) == (item.found, item.confidence, item.belief_mean)


def test_fingerprints_of_different_models_may_claim_the_same_place():
    decisions = identify(stream(), [LEARNED, replace(LEARNED, session="again")])
    for session in ("learned", "again"):
        assert_found(of(decisions, "object-1", session), [HERE])


def test_a_set_without_fingerprints_is_looked_for_in_vain():
    assert identify(stream(), [replace(LEARNED, fingerprints=())]) == []


def same(one, other):
    """Whether two decisions are equal to the last bit."""
    fields = [{**vars(item), "pose": item.pose.tolist()} for item in (one, other)]
    return fields[0] == fields[1]


def test_the_same_stream_gives_the_same_decisions():
    again = identify(stream())
    assert len(again) == len(decide()) == 3
    assert all(same(*pair) for pair in zip(again, decide()))


def test_it_makes_no_difference_in_which_parts_the_stream_comes():
    states, images = stream()
    looking = make_identification()
    for part in np.split(np.arange(len(states)), [1, 64, 65, 140]):
        looking.observe(states[part], images[part])
    assert looking.images == len(states)
    for item, expected in zip(looking.decide(states, images), decide()):
        np.testing.assert_allclose(item.pose, expected.pose, atol=1e-9)
        assert (item.found, item.views, item.reason) == (expected.found, expected.views, expected.reason)
        assert item.belief_mean == pytest.approx(expected.belief_mean, rel=1e-9)


def test_trace_holds_what_each_image_has_said_in_the_order_of_the_stream():
    states, images = (array[:100] for array in stream())
    looking = make_identification()
    looking.observe(states, images)
    for item, matches in zip(looking.sought, looking_at(states, images)):
        for name in ("view", "distance", "value", "pose"):
            np.testing.assert_allclose(getattr(item.trace, name), getattr(matches, name), atol=1e-6)
        assert item.trace.pose.shape == (100, 3)


def looking_at(states, images):
    """What each fingerprint's matches are, image by image."""
    model = PaintedModel(LEARNED.config, LEARNED.weights)
    matcher = identification.Matcher(model, LEARNED.fingerprints, SETTINGS)
    parts = [matcher.match(states[index : index + 1], images[index : index + 1]) for index in range(len(states))]
    for number in range(len(LEARNED.fingerprints)):
        own = [part[number] for part in parts]
        yield type(own[0])(
            *(np.concatenate([getattr(part, name) for part in own]) for name in ("view", "distance", "value", "pose"))
        )


@pytest.mark.parametrize(("evidence", "information"), [("tempered", 1 + 1 / 2 + 1 / 3 + 1 / 4), ("counted", 4.0)])
def test_images_from_one_place_share_the_weight_of_one_unless_each_is_counted(evidence, information):
    looking = make_identification(settings=replace(SETTINGS, evidence=evidence))
    states, images = np.tile(HERE, (4, 1)), paint(np.tile(HERE, (4, 1)), TWO, CAMERA)
    looking.observe(states, images)
    for item in looking.sought[:2]:
        smallest = 1.0 / math.sqrt(0.5 + information / SETTINGS.near_variance)
        assert item.grid.std.min() == pytest.approx(smallest, rel=0.02)


def test_each_image_is_encoded_once_by_each_model():
    looking = make_identification()
    model = looking.sought[0].verifier._model
    before = model.encoded
    looking.observe(*(array[:70] for array in stream()))
    assert model.encoded - before == 70


def test_pixels_point_to_where_things_are():
    decisions = decide(features="pixels", decision="belief")
    for name, pose in (("object-1", HERE), ("object-2", THERE)):
        distance, turn = pose_distance(of(decisions, name)[0].pose, np.array(pose))
        assert distance < 0.015
        assert turn < math.radians(40.0)
