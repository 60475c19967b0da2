"""Destinations of the visits after an identification, and the view expected at each."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from embodied_active_learning.geometry import pose_distance, transform_poses
from embodied_active_learning.objects.appearance import Appearance
from embodied_active_learning.objects.decision import FOUND, NOT_HERE, UNDECIDED
from embodied_active_learning.objects.fingerprint import BLANK, OBJECT
from embodied_active_learning.objects.unknown import UnknownObject
from embodied_active_learning.objects.visits import make_visit, plan_visits
from painted_table import PaintedModel, Thing, learn, paint
from sample_decisions import make_decision

LEARNED = learn((Thing(0, (0.40, -0.07, 0.6)),), (0.36, 0.12))
FINGERPRINT = LEARNED.fingerprints[0]
CAMERA, WORKSPACE = LEARNED.config.camera, LEARNED.config.workspace.box()
TARGET = SimpleNamespace(
    session="learned",
    label="learned/object-1",
    fingerprint=FINGERPRINT,
    appearance=Appearance(FINGERPRINT, LEARNED.fingerprints, CAMERA),
    model=PaintedModel(LEARNED.config, LEARNED.weights),
)
SEARCH = SimpleNamespace(targets=[TARGET], by_views=True)
INSIDE, OUTSIDE = np.array([0.5, 0.05, 1.1]), np.array([0.63, 0.16, -0.4])


def decide(pose, outcome=FOUND, kind=OBJECT):
    return make_decision(session="learned", kind=kind, outcome=outcome, pose=TARGET.appearance.middle_at(pose))


def plan(*decisions, unknown=()):
    return plan_visits(SEARCH, decisions, unknown, WORKSPACE)


def test_found_and_undecided_objects_are_visited():
    compared, without_views = decide(OUTSIDE, UNDECIDED), replace(decide(OUTSIDE, UNDECIDED), residual=np.inf)
    found = plan(decide(INSIDE), decide(OUTSIDE, NOT_HERE), decide(OUTSIDE, kind=BLANK), compared, without_views)
    assert [item.label for item in found] == ["learned/object-1/1", "learned/object-1/undecided"]


@pytest.mark.parametrize("pose", [INSIDE, OUTSIDE], ids=["inside", "outside"])
def test_camera_stays_in_the_workspace_near_the_object(pose):
    [destination] = plan(decide(pose))
    assert WORKSPACE.contains(destination.state, 1e-9)
    nearest = WORKSPACE.clip(pose)
    assert pose_distance(destination.state, nearest)[0] < 0.02


def test_view_and_prediction_show_object_as_camera_does():
    [destination] = plan(decide(INSIDE))
    state = WORKSPACE.clip(destination.state + np.array([0.002, 0.0, 0.05]))
    picture = paint(state[None], [Thing(0, tuple(INSIDE))], CAMERA, noise=0.0)[0]
    visit = make_visit(destination, state, picture)
    bare = paint(state[None], [], CAMERA, noise=0.0)[0]
    of_object = (picture != bare).any(axis=-1)

    def error(image):
        return np.abs(image.astype(float) - picture)[of_object].mean()

    assert error(visit.prediction) < 0.3 * error(bare)
    assert error(destination.known) < 0.3 * error(bare)


def test_prediction_is_made_in_the_learned_workspace():
    states = []
    model = SimpleNamespace(decode=lambda _latents, at: (states.append(at[0]), (np.ones((1, 2, 2, 3)), None))[1])
    target = SimpleNamespace(**{**vars(TARGET), "model": model})
    search = SimpleNamespace(targets=[target], by_views=True)
    [destination] = plan_visits(search, [decide(INSIDE)], (), WORKSPACE)
    image = destination.expected.image_from(destination.state)
    np.testing.assert_allclose(states[0], FINGERPRINT.states[destination.expected.view], atol=1e-6)
    assert image.dtype == np.uint8
    assert (image == 255).all()


def test_unknown_object_is_visited_without_prediction():
    picture = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
    [destination] = plan(unknown=[UnknownObject(np.array([0.63, 0.0]), 1e-3, picture)])
    assert destination.label == "unknown-1"
    np.testing.assert_allclose(destination.state, [WORKSPACE.upper[0], 0.0, WORKSPACE.centre[2]])
    np.testing.assert_array_equal(destination.known, picture[::-1])
    assert make_visit(destination, destination.state, picture).prediction is None


def test_belief_decision_is_the_pose_of_the_centre():
    """Decisions by belief state the pose of the fingerprint's centre, those by views that of its visible middle."""
    decision = make_decision(session="learned", pose=INSIDE)
    search = SimpleNamespace(targets=[TARGET], by_views=False)
    [destination] = plan_visits(search, [decision], (), WORKSPACE)
    expected = transform_poses(FINGERPRINT.states[destination.expected.view], FINGERPRINT.centre, INSIDE)
    np.testing.assert_allclose(destination.state, expected)
