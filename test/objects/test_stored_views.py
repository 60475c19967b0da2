"""Selection of views from stored observations."""

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.geometry import pose_distance
from embodied_active_learning.objects.stored_views import ObservedViews

CENTRE = np.array([0.47, 0.01, 0.3])
CONFIG = Config.from_dict({"fingerprint": {"views": 50}})


def stored(count, seed=0):
    box = CONFIG.workspace.box()
    states = np.random.default_rng(seed).uniform(box.lower, box.upper, (count, 3))
    return states, np.arange(count, dtype=np.uint8)[:, None, None, None] * np.ones((1, 2, 3, 3), np.uint8)


def select(states, images, seed=0, config=CONFIG, centre=CENTRE):
    return ObservedViews(config, centre, seed, states, images)


def test_stored_views_follow_view_density():
    views = select(*stored(20000))
    away = views.states[:, :2] - CENTRE[:2]
    assert views.complete
    assert np.abs(away).max() <= CONFIG.fingerprint.view_box
    np.testing.assert_allclose(away.std(axis=0), CONFIG.fingerprint.view_std, rtol=0.3)
    np.testing.assert_allclose(away.mean(axis=0), 0.0, atol=0.006)
    assert views.states[:, 2].std() > 0.9, "views do not cover the yaw range"


def test_stored_views_pair_state_with_image():
    states, images = stored(200)
    views = select(states, images, config=Config.from_dict({"fingerprint": {"views": 10}}))
    for state, image in zip(views.states, views.images):
        np.testing.assert_array_equal(images[np.flatnonzero((states == state).all(axis=1))[0]], image)


def test_stored_views_exclude_duplicates():
    states, images = stored(400)
    near = select(*stored(400)).states
    assert not select(np.repeat(near[:20], 5, axis=0), np.repeat(images[:20], 5, axis=0)).complete
    views = select(np.repeat(states, 3, axis=0), np.repeat(images, 3, axis=0))
    for index, state in enumerate(views.states):
        distance, turn = pose_distance(np.delete(views.states, index, axis=0), state)
        settings = CONFIG.fingerprint
        assert not np.any((distance < settings.min_view_distance) & (turn < settings.min_view_turn))


def test_stored_views_depend_on_seed_only():
    states, images = stored(5000)
    np.testing.assert_array_equal(select(states, images).states, select(states, images).states)
    assert not np.array_equal(select(states, images).states, select(states, images, seed=1).states)


def test_too_few_stored_views_are_incomplete():
    assert not select(*stored(60)).complete
    assert len(select(np.empty((0, 3)), np.empty((0, 2, 3, 3), np.uint8)).states) == 0
