"""Identification of painted things on a painted table."""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from unittest import mock

import numpy as np
import pytest

from embodied_active_learning.config import CameraConfig, FingerprintConfig, IdentificationConfig
from embodied_active_learning.errors import ConfigError, SessionError
from embodied_active_learning.geometry import pose_distance
from embodied_active_learning.objects import identification, scene_views, search_target, similarity
from embodied_active_learning.objects.appearance import Appearance
from embodied_active_learning.objects.calibration import calibrate
from embodied_active_learning.objects.decision import FOUND, NOT_HERE, UNDECIDED
from embodied_active_learning.objects.fingerprint import BLANK, OBJECT
from embodied_active_learning.objects.identification import Identification
from embodied_active_learning.objects.relief import Relief
from painted_table import KINDS, TABLE, PaintedModel, Thing, learn, paint, random_states

SETTINGS = IdentificationConfig(
    cells=(20, 20, 12),
    candidates=4,
    separation=0.06,
    min_belief=0.5,
    error_rate=0.1,  # the smallest one with 9 trials, which take less time than the default number
)
FINGERPRINT = {"prints": True, "trials": 9}
RED, BLUE, GREEN = Thing(0, (0.40, -0.07, 0.6)), Thing(1, (0.54, 0.06, -1.0)), Thing(2, (0.45, 0.05, 0.0))
BARE = (0.36, 0.12)
LEARNED = learn((RED, BLUE), BARE, fingerprint=FINGERPRINT)
WORKSPACE, CAMERA = LEARNED.config.workspace.box(), LEARNED.config.camera
# Poses of things, and one without; far enough apart not to be in the same view.
HERE, THERE, NOWHERE = (0.56, -0.08, 0.9), (0.38, 0.08, -0.4), (0.57, 0.10, 0.0)


def put(thing, pose):
    return thing._replace(pose=pose)


TWO = (put(RED, HERE), put(BLUE, THERE))


@functools.lru_cache(maxsize=None)
def stream(things=TWO, noise=3.0, around=(HERE, THERE, NOWHERE)):
    """Return states across the workspace, denser around given poses, and their images."""
    random = np.random.default_rng(3)
    places = [random.uniform(np.subtract(pose, 0.03), np.add(pose, 0.03), (40, 3)) for pose in around]
    states = WORKSPACE.clip(np.concatenate([random_states(WORKSPACE, 60, seed=3), *places]))
    states[:, 2] = random.permutation(np.linspace(-2.0, 2.0, len(states)))
    return states, paint(states, things, CAMERA, noise, seed=9)


def make_identification(sets=(LEARNED,), settings=SETTINGS, camera=CAMERA):
    with mock.patch.object(identification, "TrainedModel", PaintedModel):
        return Identification(sets, WORKSPACE, camera, settings)


CALIBRATIONS = {}


def calibrated(appearance, trials):
    """Calibrate objects with the same views once."""
    key = appearance.fingerprint.states.tobytes(), appearance.fingerprint.images.tobytes(), trials
    if key not in CALIBRATIONS:
        CALIBRATIONS[key] = calibrate(appearance, trials)
    return CALIBRATIONS[key]


@pytest.fixture(scope="module", autouse=True)
def _learn_once():
    """Learn appearance and limits of each fingerprint once, which takes most of the time of an identification."""
    learned = functools.lru_cache(maxsize=None)(Appearance)
    with mock.patch.multiple(search_target, Appearance=learned, calibrate=calibrated):
        yield


def identify(images, sets=(LEARNED,), settings=SETTINGS):
    """Observe a stream and return the decisions."""
    search = make_identification(sets, settings)
    search.observe(*images)
    return search.decide(*images)


@functools.lru_cache(maxsize=None)
def decide(things=TWO, **settings):
    """Return the decisions for things on the table, with changed settings."""
    return tuple(identify(stream(things), settings=replace(SETTINGS, **settings)))


def of(decisions, name, session="learned"):
    return [item for item in decisions if (item.session, item.fingerprint) == (session, name)]


def assert_found(decisions, poses):
    """Check that all poses are found within 1 cm and 20 degrees, in any order, and numbered consecutively."""
    assert [item.instance for item in decisions] == list(range(1, len(poses) + 1))
    for item in decisions:
        assert item.found
        assert item.confidence >= 0.9  # the highest one with 9 trials
    for pose in poses:
        errors = [pose_distance(item.pose, np.array(pose)) for item in decisions]
        assert any(distance < 0.01 and turn < math.radians(20.0) for distance, turn in errors)


def assert_not_found(decisions):
    """Check that there is one decision, not found, with a reason."""
    assert len(decisions) == 1
    assert decisions[0].outcome != FOUND
    assert decisions[0].instance == 0
    assert decisions[0].reason


def test_moved_and_turned_objects_are_found():
    assert_found(of(decide(), "object-1"), [HERE])
    assert_found(of(decide(), "object-2"), [THERE])


@pytest.mark.parametrize(("trials", "enough"), [(4, False), (9, True)])
def test_small_error_rate_needs_trials_of_the_fingerprint(trials, enough):
    made = replace(LEARNED, config=replace(LEARNED.config, fingerprint=FingerprintConfig(trials=trials)))
    problem = make_identification((made,), SETTINGS).targets[0].problem
    assert (problem == "") is enough
    assert enough or "from 0.2 on, not 0.1: raise fingerprint/trials, then fingerprint the session again" in problem


def test_decision_reports_evidence_and_reason():
    red, blue, blank = decide()
    assert [item.fingerprint for item in (red, blue, blank)] == ["object-1", "object-2", "blank-1"]
    assert [item.kind for item in (red, blue, blank)] == [OBJECT, OBJECT, BLANK]
    for item in (red, blue):
        assert item.reason.startswith(f"similarity {1.0 - item.residual:.2f}, limit ")
        assert 2 <= item.views <= SETTINGS.views
    assert blank.reason.endswith("% of the place has the table's colours")
    for item in (red, blue, blank):
        assert 0.0 <= item.residual < 1.0
        assert item.error_rate == SETTINGS.error_rate
        assert 0.0 < item.belief_mean < 1.0
        assert 0.0 < item.belief_std < math.sqrt(2.0)


def test_all_instances_found_most_similar_first():
    decisions = decide((put(RED, HERE), put(RED, THERE)))
    assert_found(of(decisions, "object-1"), [HERE, THERE])
    residuals = [item.residual for item in of(decisions, "object-1")]
    assert residuals == sorted(residuals)
    assert_not_found(of(decisions, "object-2"))


@pytest.mark.parametrize("yaw", [0.0, math.pi])
def test_instances_beside_each_other_are_found_with_any_centre(yaw):
    """The distance of instances is that of their visible middles, wherever clustering has put the centre."""
    red = LEARNED.fingerprints[0]
    cosine, sine = math.cos(red.centre[2]), math.sin(red.centre[2])
    centre = red.centre + 0.015 * np.array([cosine, sine, 0.0])
    sets = (replace(LEARNED, fingerprints=(replace(red, centre=centre),)),)
    left, right = (0.43, 0.0, yaw), (0.50, 0.0, yaw)  # 7 cm apart, separation 6 cm
    images = stream((put(RED, left), put(RED, right)), around=(left, right))
    assert_found(of(identify(images, sets), "object-1"), [left, right])


@pytest.mark.parametrize("change", [lambda images: images // 2, lambda images: images * 0.75])
def test_object_and_blank_are_found_at_other_brightness(change):
    states, images = stream()
    decisions = identify((states, change(images).astype(np.uint8)))
    assert_found(of(decisions, "object-1"), [HERE])
    assert of(decisions, "blank-1")[0].found


def test_object_is_found_on_table_of_another_colour():
    states, images = stream(noise=0.0)
    other = np.where((images == TABLE).all(axis=3, keepdims=True), np.uint8((60, 110, 90)), images)
    decisions = identify((states, other))
    assert_found(of(decisions, "object-1"), [HERE])
    (blank,) = of(decisions, "blank-1")
    assert (blank.outcome, blank.reason) == (UNDECIDED, "this table is unknown: learn it to search for bare places")


def test_table_of_object_colours_leaves_absence_undecided():
    states = random_states(WORKSPACE, 400, seed=3)
    colour = np.full((400, CAMERA.height, CAMERA.width, 3), KINDS[1][0], np.uint8)
    decisions = identify((states, colour))
    (blue,) = of(decisions, "object-2")
    assert blue.outcome == UNDECIDED
    assert "colour" in blue.reason
    assert of(decisions, "object-1")[0].outcome == NOT_HERE


def test_unseen_workspace_leaves_absence_undecided():
    states, images = stream((put(BLUE, THERE),))
    near = states[:, 0] < 0.45
    decisions = identify((states[near], images[near]))
    (red,) = of(decisions, "object-1")
    assert red.outcome == UNDECIDED
    assert "% of the workspace seen: take more images" in red.reason
    assert_found(of(decisions, "object-2"), [THERE])


def test_nothing_found_before_first_image():
    search = make_identification()
    assert search.image_count == 0
    assert search.targets[0].trace.pose.shape == (0, 3)
    for item in search.decide(np.empty((0, 3)), np.empty((0, 45, 45, 3), np.uint8)):
        assert_not_found([item])
        assert item.outcome == UNDECIDED
        assert item.views == 0


def test_fingerprint_without_object_is_undecided_with_remedy():
    """A weak model may have placed a cluster on the bare table."""
    bare = replace(LEARNED.fingerprints[2], name="object-3", kind=OBJECT)
    (decision,) = of(identify(stream(), [with_fingerprints(*LEARNED.fingerprints, bare)]), "object-3")
    assert decision.outcome == UNDECIDED
    assert decision.reason.startswith("no object distinct from the table in its views: train longer")


def test_reset_search_gives_decisions_of_new_search():
    search = make_identification()
    search.observe(*stream((put(RED, THERE),)))
    search.reset()
    assert search.image_count == 0
    search.observe(*stream())
    for one, other in zip(search.decide(*stream()), decide()):
        np.testing.assert_array_equal(one.pose, other.pose)
        assert (one.outcome, one.belief_mean) == (other.outcome, other.belief_mean)


def test_candidates_of_belief_find_same_objects():
    decisions = decide(candidates_from="belief")
    assert_found(of(decisions, "object-1"), [HERE])
    assert_found(of(decisions, "object-2"), [THERE])


def test_most_similar_fingerprint_wins_overlap():
    """One of two fingerprints of the same thing shows it from fewer positions."""
    whole, part = LEARNED.fingerprints[0], copy_of_red(slice(0, 25))
    settings = replace(SETTINGS, candidates=1)
    decisions = identify(stream(), [with_fingerprints(part, whole, *LEARNED.fingerprints[1:])], settings)
    (winner,) = [item for item in of(decisions, "object-1") + of(decisions, "object-3") if item.found]
    (other,) = [item for item in of(decisions, "object-1") + of(decisions, "object-3") if not item.found]
    assert winner.residual <= other.residual
    assert other.reason == f"{winner.fingerprint} is more similar there"


@pytest.mark.parametrize("pose", [(0.615, 0.14, 1.5), (0.33, -0.145, -0.7)])
def test_object_near_workspace_border_is_found(pose):
    assert_found(of(identify(stream((put(RED, pose),), around=(pose, pose, pose))), "object-1"), [pose])


def test_agreeing_views_override_believed_yaw():
    search = make_identification()
    search.observe(*stream())
    wrong = np.array([(*HERE[:2], HERE[2] + 2.5)] * 20)
    search.targets[0].grid.update(wrong, np.ones(20), np.ones(20))
    pose, _, _ = search.targets[0].grid.peaks(SETTINGS.separation, 1)[0]
    _, turn = pose_distance(pose, wrong[0])
    assert turn < 0.5
    assert_found(of(search.decide(*stream()), "object-1"), [HERE])


def test_absent_object_is_not_found_on_another():
    decisions = decide((put(RED, HERE),))
    assert_found(of(decisions, "object-1"), [HERE])
    assert_not_found(of(decisions, "object-2"))


def test_print_that_looks_like_an_object_is_not_found(monkeypatch):
    """Of two equal discs, the one seen as flat is no object, unless the fingerprint itself may be of a print."""
    images, printed = stream((put(RED, HERE), put(RED, THERE))), np.array(THERE[:2])

    def relief_at(place, *images):
        return Relief(place, np.full((19, 19), np.hypot(*(place - printed)) > 0.03), np.zeros((19, 19)))

    monkeypatch.setattr(scene_views, "relief_at", relief_at)
    without_prints = replace(LEARNED, config=replace(LEARNED.config, fingerprint=FingerprintConfig(trials=9)))
    assert_found(of(identify(images, (without_prints,)), "object-1"), [HERE])
    assert_found(of(identify(images), "object-1"), [HERE, THERE])


@pytest.mark.parametrize("things", [(), (put(GREEN, HERE),)])
def test_only_blank_found_without_known_objects(things):
    """On a bare table, and beside an unknown object."""
    decisions = decide(things)
    assert [item.fingerprint for item in decisions if item.found] == ["blank-1"]


def test_decision_exists_if_belief_peaks_in_margin():
    """After low measurements all over the workspace, the belief is highest in the margin around it."""
    search = make_identification()
    poses = np.array([[x, y, 0.0] for x in np.linspace(0.35, 0.6, 6) for y in np.linspace(-0.12, 0.12, 6)])
    for item in search.targets:
        item.grid.update(poses, np.full(36, 0.2), np.ones(36))
        assert not WORKSPACE.contains(highest(item.grid))
    decisions = search.decide(np.empty((0, 3)), np.empty((0, 45, 45, 3), np.uint8))
    assert [item.fingerprint for item in decisions] == ["object-1", "object-2", "blank-1"]
    for item in decisions:
        assert_not_found([item])


def highest(grid):
    x, y, _ = np.unravel_index(grid.mean.argmax(), grid.mean.shape)
    return [grid.x[x], grid.y[y], 0.0]


def test_blank_is_found_once_on_bare_table():
    (blank,) = of(decide(), "blank-1")
    assert (blank.found, blank.instance) == (True, 1)
    assert blank.pose[2] == LEARNED.fingerprints[-1].centre[2]  # a blank keeps the yaw of its fingerprint
    for thing in TWO:
        assert np.hypot(*(blank.pose[:2] - thing.pose[:2])) > thing.radius + 0.02


def copy_of_red(views=slice(None), name="object-3"):
    """Return a copy of the red thing's fingerprint, or part of its views."""
    red = LEARNED.fingerprints[0]
    arrays = {field: getattr(red, field)[views] for field in ("states", "images", "latent_means", "latent_stds")}
    return replace(red, name=name, **arrays)


def with_fingerprints(*fingerprints):
    return replace(LEARNED, fingerprints=fingerprints)


def test_equal_confidence_gives_one_claim_per_place():
    decisions = identify(stream(), [with_fingerprints(LEARNED.fingerprints[0], copy_of_red(), LEARNED.fingerprints[1])])
    found = [item.fingerprint for item in decisions if item.found]
    assert found in (["object-1", "object-2"], ["object-3", "object-2"])


def test_belief_decision_compares_mean_with_limit():
    decisions = decide(decision="belief")
    for item in decisions:
        assert item.found == (item.belief_mean > 0.5)
        relation = "above" if item.found else "not above"
        assert item.reason == f"belief {item.belief_mean:.2f} {relation} 0.5"
    lower = of(decide(decision="belief", min_belief=0.05), "object-2")
    assert lower[0].found
    assert_not_found(of(decide(decision="belief", min_belief=0.999), "object-1"))


def test_belief_decision_gives_overlap_to_higher_belief():
    sets = [with_fingerprints(copy_of_red(slice(0, 25)), LEARNED.fingerprints[0], LEARNED.fingerprints[1])]
    decisions = identify(stream(), sets, replace(SETTINGS, decision="belief", min_belief=0.3))
    claims = of(decisions, "object-1") + of(decisions, "object-3")
    here = [item for item in claims if np.hypot(*(item.pose[:2] - HERE[:2])) < 0.03]
    assert len(here) == 2
    winner, other = sorted(here, key=lambda item: -item.belief_mean)
    assert winner.belief_mean > other.belief_mean > 0.3
    assert (winner.found, other.found) == (True, False)
    assert other.reason == f"{winner.fingerprint} is more similar there"


def test_belief_decision_needs_no_views():
    states, images = stream()
    search = make_identification(settings=replace(SETTINGS, decision="belief", min_belief=0.3))
    search.observe(states, images)
    red = of(search.decide(states[:0], images[:0]), "object-1")[0]
    assert red.found
    assert red.views == 0


@pytest.mark.parametrize(("key", "value"), [("width", 46), ("height", 44), ("field_of_view", 31.0), ("distance", 0.31)])
def test_camera_mismatch_names_key(key, value):
    match = rf"camera mismatch: session learned was trained with camera/{key} = .*, the images have {value}"
    with pytest.raises(ConfigError, match=match):
        make_identification(camera=replace(CAMERA, **{key: value}))


def test_sessions_of_one_name_are_refused():
    """Their decisions and belief grids would be stored under the same name."""
    other = replace(LEARNED, created="2026-11-23T12:45:00Z")
    with pytest.raises(SessionError, match="two sets of fingerprints are of sessions named learned"):
        make_identification(sets=(LEARNED, other))


def test_irrelevant_camera_settings_may_differ():
    assert isinstance(CAMERA, CameraConfig)
    assert len(make_identification(camera=replace(CAMERA, max_age=9.0)).targets) == 3


def test_two_sessions_searched_independently_in_one_stream():
    first, second = replace(LEARNED, session="a"), learn((GREEN,), session="b", fingerprint=FINGERPRINT)
    images = stream((put(RED, HERE), put(GREEN, THERE)))
    together = identify(images, [first, second])
    assert_found(of(together, "object-1", "a"), [HERE])
    assert_not_found(of(together, "object-2", "a"))
    assert_found(of(together, "object-1", "b"), [THERE])
    assert [item.session for item in together] == ["a", "a", "a", "b"]
    for sets in ([first], [second]):
        for item in identify(images, sets):
            (same,) = of(together, item.fingerprint, item.session)
            np.testing.assert_array_equal(same.pose, item.pose)
            assert (same.found, same.confidence, same.belief_mean) == (item.found, item.confidence, item.belief_mean)


def test_models_may_claim_same_place():
    decisions = identify(stream(), [LEARNED, replace(LEARNED, session="again")])
    for session in ("learned", "again"):
        assert_found(of(decisions, "object-1", session), [HERE])


def test_empty_set_gives_no_decisions():
    assert identify(stream(), [replace(LEARNED, fingerprints=())]) == []


def same(one, other):
    """Return whether two decisions are bit-identical."""
    fields = [{**vars(item), "pose": item.pose.tolist()} for item in (one, other)]
    return fields[0] == fields[1]


def test_decisions_are_deterministic():
    again = identify(stream(), [with_fingerprints(*map(replace, LEARNED.fingerprints))])  # learned again
    assert len(again) == len(decide()) == 3
    assert all(same(*pair) for pair in zip(again, decide()))


def test_result_independent_of_stream_chunks():
    states, images = stream()
    search = make_identification()
    for part in np.split(np.arange(len(states)), [1, 64, 65, 140]):
        search.observe(states[part], images[part])
    assert search.image_count == len(states)
    for item, expected in zip(search.decide(states, images), decide()):
        np.testing.assert_allclose(item.pose, expected.pose, atol=1e-9)
        assert (item.found, item.views, item.reason) == (expected.found, expected.views, expected.reason)
        assert item.belief_mean == pytest.approx(expected.belief_mean, rel=1e-9)


def test_trace_holds_matches_in_stream_order():
    states, images = (array[:100] for array in stream())
    search = make_identification()
    search.observe(states, images)
    for item, matches in zip(search.targets, matches_one_by_one(states, images)):
        for name in ("view", "distance", "value", "pose"):
            np.testing.assert_allclose(getattr(item.trace, name), getattr(matches, name), atol=1e-6)
        assert item.trace.pose.shape == (100, 3)


def matches_one_by_one(states, images):
    """Yield each fingerprint's matches, computed image by image."""
    model = PaintedModel(LEARNED.config, LEARNED.weights)
    matcher = identification.Matcher(model, LEARNED.fingerprints, SETTINGS)
    parts = [matcher.match(states[index : index + 1], images[index : index + 1]) for index in range(len(states))]
    for number in range(len(LEARNED.fingerprints)):
        own = [part[number] for part in parts]
        yield type(own[0])(
            *(np.concatenate([getattr(part, name) for part in own]) for name in ("view", "distance", "value", "pose"))
        )


@pytest.mark.parametrize(("evidence", "information"), [("tempered", 1 + 1 / 2 + 1 / 3 + 1 / 4), ("counted", 4.0)])
def test_evidence_setting_weights_repeated_images(evidence, information):
    search = make_identification(settings=replace(SETTINGS, evidence=evidence))
    states, images = np.tile(HERE, (4, 1)), paint(np.tile(HERE, (4, 1)), TWO, CAMERA)
    search.observe(states, images)
    for item in search.targets[:2]:
        smallest = 1.0 / math.sqrt(0.5 + information / SETTINGS.near_variance)
        assert item.grid.std.min() == pytest.approx(smallest, rel=0.02)


def test_pixel_features_locate_objects():
    decisions = decide(features="pixels", decision="belief")
    for name, pose in (("object-1", HERE), ("object-2", THERE)):
        distance, turn = pose_distance(of(decisions, name)[0].pose, np.array(pose))
        assert distance < 0.015
        assert turn < math.radians(40.0)


def views_of(*poses, count):
    """Return the first states and images of the stream around poses, a few of each."""
    states, images = stream(around=poses)
    rows = np.concatenate([np.arange(60 + 40 * index, 60 + 40 * index + count) for index in range(len(poses))])
    return states[rows], images[rows]


def test_found_object_is_decided_before_the_workspace_is_seen():
    search = make_identification()
    red, blue, _ = search.decide(*views_of(HERE, count=5))
    assert red.found
    assert blue.outcome == UNDECIDED
    assert "of the workspace seen: take more images" in blue.reason
    assert not search.all_closed


def test_decision_is_kept_and_rest_is_decided_by_more_images():
    search = make_identification()
    first = search.decide(*views_of(HERE, count=5))[0]
    later = search.decide(*stream())
    assert search.all_closed
    assert search.open_places.shape == (0, 2)
    np.testing.assert_array_equal(first.pose, later[0].pose)
    assert_found(of(later, "object-2"), [THERE])


def test_place_with_too_few_views_is_open():
    states, images = stream()
    far = np.hypot(*(states[:, :2] - HERE[:2]).T) > SETTINGS.view_distance
    search = make_identification()
    red = search.decide(states[far], images[far])[0]
    assert (red.outcome, red.reason) == (UNDECIDED, "a candidate place has too few views: take more images")
    assert not search.all_closed
    assert np.hypot(*(search.open_places - HERE[:2]).T).min() < 0.02


def test_place_that_no_view_shows_is_undecided(monkeypatch):
    monkeypatch.setattr(similarity, "_MIN_INSIDE", 2.0)  # of the points of an object
    red = of(identify(stream()), "object-1")[0]
    assert (red.outcome, red.reason) == (UNDECIDED, "no image shows enough of a candidate place: take more images")
    assert math.isinf(red.residual)


def test_distant_views_suffice_where_nothing_is_similar():
    states = random_states(WORKSPACE, 300, seed=3)
    far = np.hypot(*(states[:, :2] - HERE[:2]).T) > SETTINGS.view_distance
    search = make_identification()
    red = search.decide(states[far], paint(states[far], (put(BLUE, THERE),), CAMERA))[0]
    assert red.outcome == NOT_HERE, red.reason


def test_belief_decision_never_stops_early():
    search = make_identification(settings=replace(SETTINGS, decision="belief"))
    search.observe(*stream())
    search.decide(*stream())
    assert not search.all_closed


def test_belief_decision_composes_no_mosaic(monkeypatch):
    monkeypatch.delattr(scene_views, "Mosaic")
    search = make_identification(settings=replace(SETTINGS, decision="belief"))
    assert len(search.decide(*views_of(HERE, count=5))) == 3
