"""Object pixels of a fingerprint's views, their similarity elsewhere, and the limits that follow from them."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest

from embodied_active_learning.config import IdentificationConfig
from embodied_active_learning.figures.evidence import Evidence, draw_evidence
from embodied_active_learning.geometry import pose_distance, to_base_frame, to_object_frame
from embodied_active_learning.objects import colours, simulated_views
from embodied_active_learning.objects.appearance import Appearance, grid_cells
from embodied_active_learning.objects.bare_table import BareTable
from embodied_active_learning.objects.calibration import calibrate
from embodied_active_learning.objects.colours import (
    balance_jacobian,
    colour_features,
    colours_of,
    dark_factor,
    luminance_of,
)
from embodied_active_learning.objects.fingerprint import BLANK
from embodied_active_learning.objects.pose_search import best_pose, propose, refine
from embodied_active_learning.objects.scene_views import MOSAIC_PIXEL, Mosaic, SceneViews
from embodied_active_learning.objects.similarity import nearest_stored_views, similarity
from painted_table import Thing, learn, paint, random_states
from sample_decisions import make_decision

SETTINGS = IdentificationConfig()
TRIALS = 9
RED, BLUE = Thing(0, (0.40, -0.07, 0.6)), Thing(1, (0.54, 0.06, -1.0))
LEARNED = learn((RED, BLUE), (0.36, 0.12))
CAMERA, WORKSPACE = LEARNED.config.camera, LEARNED.config.workspace.box()
PLACE = (0.50, -0.03, 1.1)
POINTS = np.add(LEARNED.fingerprints[0].centre[:2], np.random.default_rng(0).uniform(-0.005, 0.005, (500, 2)))
"""Points of the red thing on the table."""


@pytest.fixture(scope="module")
def appearance():
    return Appearance(LEARNED.fingerprints[0], LEARNED.fingerprints, CAMERA)


@pytest.fixture(scope="module")
def views():
    """Views of the red thing at another place, and of the blue one."""
    states = np.concatenate([random_states(WORKSPACE, 150, seed=3), np.add(PLACE, np.zeros((5, 3)))])
    things = (RED._replace(pose=PLACE), BLUE._replace(pose=(0.38, 0.09, 0.3)))
    return SceneViews(states, paint(states, things, CAMERA), CAMERA)


def test_appearance_has_area_and_middle_of_painted_disc(appearance):
    assert appearance.problem == ""
    assert appearance.usable.all()
    assert appearance.area == pytest.approx(np.pi * RED.radius**2, rel=0.15)
    np.testing.assert_allclose(appearance.middle, 0.0, atol=0.002)


def test_colours_of_object_that_reaches_far_are_not_the_table(monkeypatch):
    """Beyond the reach, the views of its fingerprint and of another one are taken for views of the table."""
    large = RED._replace(radius=0.045)
    found = learn((large, BLUE._replace(pose=(0.49, -0.03, -1.0))), (0.36, 0.12))
    monkeypatch.setattr(colours, "OBJECT_REACH", 0.02)
    appearance = Appearance(found.fingerprints[0], found.fingerprints, CAMERA)
    assert appearance.problem == ""
    assert appearance.area == pytest.approx(np.pi * large.radius**2, rel=0.15)


def test_middle_and_centre_are_inverse(appearance):
    shifted = appearance.middle_at(np.array(PLACE))
    np.testing.assert_allclose(appearance.centre_at(shifted), PLACE, atol=1e-6)


def test_object_points_are_placed_by_pose():
    points = np.array([[0.02, 0.0], [0.0, 0.01]], np.float32)
    placed = to_base_frame(points, np.array([[0.5, 0.1, np.pi / 2]]))
    np.testing.assert_allclose(placed, [[[0.5, 0.12], [0.49, 0.1]]], atol=1e-6)
    np.testing.assert_allclose(to_object_frame(placed[0], np.array([0.5, 0.1, np.pi / 2])), points, atol=1e-6)


def test_colours_follow_from_features():
    colours = np.random.default_rng(0).integers(0, 256, (100, 3)).astype(np.uint8)
    np.testing.assert_allclose(colours_of(colour_features(colours)), colours, atol=0.01)


def test_balance_jacobian_has_the_derivatives():
    colours, step = np.array([[200.0, 100.0, 40.0], [20.0, 60.0, 230.0]]), 1e-3
    shares = 3.0 * colours / colours.sum(axis=1, keepdims=True)
    jacobian = balance_jacobian(np.concatenate([np.zeros((2, 1)), shares[:, :2]], axis=1))
    for channel in range(2):
        changed = colours * np.exp(step * np.eye(3)[channel])
        change = (3.0 * changed / changed.sum(axis=1, keepdims=True) - shares)[:, :2] / step
        np.testing.assert_allclose(jacobian[:, :, channel], change, atol=0.002)


@pytest.mark.parametrize(("gains", "is_explained"), [((1.1, 1.0, 0.9), True), ((1.0, 1.0, 0.3), False)])
def test_white_balance_does_not_explain_a_missing_channel(appearance, gains, is_explained):
    """A red thing has little blue, and whether it lacks that too must count."""
    states = np.add(PLACE, np.zeros((5, 3)))
    images = paint(states, (RED._replace(pose=PLACE),), CAMERA)
    changed = np.minimum(images * np.array(gains), 255.0).astype(np.uint8)
    poses = np.array([PLACE])
    as_is, other = (
        similarity(appearance, SceneViews(states, part, CAMERA), [0], [appearance.central_view], poses)[0]
        for part in (images, changed)
    )
    assert (other > 0.9 * as_is) == is_explained


def test_brightness_scales_shares_by_dark_factor():
    colours = np.array([[200, 100, 40], [92, 180, 60], [40, 20, 8]], np.uint8)
    bright, dark = colour_features(colours), colour_features(colours // 4)
    assert np.all(dark[:, 0] < bright[:, 0] - 0.6)
    scale = dark_factor(luminance_of(dark)) / dark_factor(luminance_of(bright))
    np.testing.assert_allclose(dark[:, 1:], bright[:, 1:] * scale[:, None], atol=0.01)


@pytest.mark.parametrize("kind", [0, 3])  # red and yellow, black and white
def test_similarity_is_the_same_in_little_light(kind):
    thing = Thing(kind, (0.40, -0.07, 0.6))
    learned = learn((thing,), (0.36, 0.12))
    appearance = Appearance(learned.fingerprints[0], learned.fingerprints, CAMERA)
    states = np.add(PLACE, np.zeros((1, 3)))
    images = paint(states, (thing._replace(pose=PLACE),), CAMERA)
    bright, dark = (
        similarity(appearance, SceneViews(states, part, CAMERA), [0], [appearance.central_view], np.array([PLACE]))[0]
        for part in (images, (images * 0.4).astype(np.uint8))
    )
    assert dark == pytest.approx(bright, abs=0.03)


def test_similarity_is_high_at_object_and_low_elsewhere(appearance, views):
    poses = np.array([PLACE, (0.58, 0.08, 0.0), (0.38, 0.09, 0.3)])
    values = []
    for pose in poses:
        chosen = views.nearest(pose[:2], 5, 0.06)
        values.append(
            similarity(appearance, views, chosen, nearest_stored_views(appearance, views, chosen, pose), pose[None])[0]
        )
    assert values[0] > 0.5
    assert max(values[1:]) < 0.2


def test_similarity_without_object_in_view_is_lowest(appearance, views):
    far = np.array([[2.0, 2.0, 0.0]])
    assert similarity(appearance, views, [0, 1], [0, 0], far)[0] == -1.0


def test_search_finds_pose_without_model(appearance, views):
    mosaic = Mosaic(views, WORKSPACE, 0.02)
    assert mosaic.coverage > 0.95
    places = propose(mosaic, appearance, 4).places
    found = [refine(appearance, views, starts, SETTINGS, mosaic.above(starts[0, :2])) for starts in places]
    best = max(found, key=lambda item: item.similarity)
    distance, turn = pose_distance(best.pose, np.array(PLACE))
    assert distance < 0.005
    assert turn < 0.3


def test_mosaic_shows_the_whole_margin(views):
    workspace = WORKSPACE.upper[:2] - np.array(WORKSPACE.lower[:2])
    for margin in (0.0225, 0.2):
        inside = Mosaic(views, WORKSPACE, margin).inside
        assert inside.sum() * MOSAIC_PIXEL**2 == pytest.approx(np.prod(workspace + 2.0 * margin), rel=0.02)


def test_candidates_are_not_searched_across_the_border(appearance):
    """An object far from its centre: the centre of the one at the left border is not at the right border."""
    offset, thing = 0.07, RED._replace(pose=(WORKSPACE.lower[0] - 0.07, 0.0, 0.0))
    shifted = copy.copy(appearance)
    shifted.inside_points, shifted.ring_points = (
        points + np.array((offset, 0.0), np.float32) for points in (appearance.inside_points, appearance.ring_points)
    )
    states = np.concatenate([random_states(WORKSPACE, 150, seed=3), WORKSPACE.clip(np.tile(thing.pose, (5, 1)))])
    mosaic = Mosaic(SceneViews(states, paint(states, (thing,), CAMERA), CAMERA), WORKSPACE, 0.0225)
    starts = propose(mosaic, shifted, 1).places[0]
    assert starts[0, 0] < WORKSPACE.centre[0]


def test_search_follows_a_start_that_is_not_the_best_one(appearance, views):
    """Beside the place, the right yaw is less similar than a wrong one at the place."""
    turned, beside = np.add(PLACE, (0.0, 0.0, 1.2)), np.add(PLACE, (0.009, 0.0, 0.0))
    pose = best_pose(appearance, views, views.nearest(np.array(PLACE[:2]), 5, 0.06), np.array([turned, beside]))
    assert pose_distance(pose, np.array(PLACE))[1] < 0.2


def test_true_views_exceed_most_look_alikes(appearance):
    limits = calibrate(appearance, TRIALS)
    assert np.median(limits.true) > np.quantile(limits.false, 0.75)
    np.testing.assert_array_equal(limits.true, calibrate(appearance, TRIALS).true)


def test_fingerprints_are_calibrated_by_draws_of_their_own(appearance):
    """Not by the same tables and lights, whose luck all limits would share."""
    first = appearance.fingerprint
    other = Appearance(replace(first, states=first.states + 1e-9), LEARNED.fingerprints, CAMERA)
    difference = np.abs(calibrate(appearance, 9).true - calibrate(other, 9).true)
    assert difference.max() > 0.01


def test_bare_place_shows_table_of_blank(views):
    blank = BareTable(LEARNED.fingerprints[2], LEARNED.fingerprints, CAMERA)
    found = blank.search(Mosaic(views, WORKSPACE, 0.02))
    assert found.known
    assert found.share >= blank.limit(0.05) >= 0.9
    assert np.hypot(*(found.place - PLACE[:2])) > RED.radius + 0.02


def test_bare_place_lies_in_workspace(views):
    """The mosaic shows more of the table, because an object may stand on the border."""
    mosaic = Mosaic(views, WORKSPACE, 0.02)
    mosaic.features[mosaic.in_workspace] = 9.0
    place = BareTable(LEARNED.fingerprints[2], LEARNED.fingerprints, CAMERA).search(mosaic).place
    assert WORKSPACE.contains([*place, 0.0])


def test_bare_place_needs_table_even_if_blank_shows_an_object():
    """The model may have placed its blank beside an object."""
    beside = replace(LEARNED.fingerprints[0], kind=BLANK, name="blank-2")
    assert BareTable(beside, (*LEARNED.fingerprints[1:], beside), CAMERA).limit(0.05) == 0.9


def test_object_of_table_colour_has_problem_with_remedy():
    bare = replace(LEARNED.fingerprints[2], kind="object", name="object-3")
    found = Appearance(bare, (*LEARNED.fingerprints, bare), CAMERA)
    assert found.problem.startswith("no object distinct from the table")


def test_evidence_figure_is_written(appearance, views, tmp_path):
    evidence = Evidence("a/object-1", appearance, make_decision(pose=PLACE, reason="similarity"))
    path = draw_evidence(tmp_path / "evidence.png", [evidence], views)
    assert path.stat().st_size > 10_000


def test_simulated_light_and_noise_are_those_of_a_camera(appearance, monkeypatch):
    """Half the light halves all channels, and noise is added in levels."""
    for name, value in {
        "_GAIN_RANGE": (-0.7, -0.7),
        "_MAX_GRADIENT": 0.0,
        "_MAX_BALANCE": 0.0,
        "_DIFFERENCE": (0.0, 0.0),
    }.items():
        monkeypatch.setattr(simulated_views, name, value)
    scenes = []
    for noise in (0.0, 2.0):
        monkeypatch.setattr(simulated_views, "_NOISE", (noise, noise))
        simulated = simulated_views.SimulatedViews(appearance, np.random.default_rng(0))
        simulated._kept = 1.0  # light from the same side
        scenes.append(colours_of(simulated.features(0, POINTS)[0]))
    rows, columns, _ = grid_cells(to_object_frame(POINTS, appearance.fingerprint.centre))
    np.testing.assert_allclose(scenes[0], appearance.colours[0, rows, columns] * np.exp(-0.7), atol=1.0)
    assert (scenes[1] - scenes[0]).std() == pytest.approx(2.0, rel=0.2)
