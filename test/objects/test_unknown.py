"""Unknown objects on a painted table."""

import numpy as np
import pytest

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.figures.unknown_objects import draw_unknown
from embodied_active_learning.objects.decision import FOUND, NOT_HERE
from embodied_active_learning.objects.decision_table import unknown_text
from embodied_active_learning.objects.scene_views import Mosaic, SceneViews
from embodied_active_learning.objects.unknown import find_unknown
from embodied_active_learning.workspace import Workspace
from painted_table import Thing, paint, random_states
from sample_decisions import make_decision

CAMERA, WORKSPACE = CameraConfig(width=45, height=45), Workspace()
SMALL = Thing(0, (0.40, -0.07, 0.6), height=0.03)
LARGE = Thing(1, (0.54, 0.06, -1.0), radius=0.03, height=0.03)


def scene_of(*things, change=lambda images: images, camera=CAMERA):
    states = random_states(WORKSPACE, 150, seed=1)
    views = SceneViews(states, change(paint(states, things, camera, seed=2)), camera)
    return views, Mosaic(views, WORKSPACE, 0.02)


def decided(outcome, thing):
    return make_decision(outcome=outcome, pose=thing.pose)


@pytest.mark.parametrize("gain", [0.6, 1.0])
def test_unknown_objects_are_located_largest_first(gain):
    scene = scene_of(SMALL, LARGE, change=lambda images: (gain * images).astype(np.uint8))
    found = find_unknown(*scene, (), 0.06)
    for item, thing in zip(found, (LARGE, SMALL)):
        assert np.hypot(*(item.place - thing.pose[:2])) < 0.01
        assert item.area == pytest.approx(np.pi * thing.radius**2, rel=0.4)
    assert len(found) == 2


def test_found_object_is_not_unknown():
    scene = scene_of(SMALL, LARGE)
    (item,) = find_unknown(*scene, [decided(FOUND, LARGE), decided(NOT_HERE, SMALL)], 0.06)
    assert np.hypot(*(item.place - SMALL.pose[:2])) < 0.01


def test_bare_and_irregular_tables_have_no_unknown_objects():
    assert find_unknown(*scene_of(), (), 0.06) == []
    random = np.random.default_rng(0)
    noise = scene_of(change=lambda images: random.integers(0, 256, images.shape, dtype=np.uint8))
    assert find_unknown(*noise, (), 0.06) == []


def test_print_is_not_unknown():
    views, mosaic = scene_of(SMALL, LARGE._replace(height=0.0), camera=CameraConfig(width=90, height=90))
    (item,) = find_unknown(views, mosaic, (), 0.06)
    assert np.hypot(*(item.place - SMALL.pose[:2])) < 0.01


def test_unknown_objects_are_drawn_and_reported(tmp_path):
    found = find_unknown(*scene_of(SMALL), (), 0.06)
    assert draw_unknown(tmp_path / "unknown.png", found).stat().st_size > 2000
    x, y = found[0].place
    assert unknown_text(found).startswith(f"unknown objects: x {x:.3f}, y {y:.3f} m (")
    assert unknown_text([]) == "unknown objects: none"
