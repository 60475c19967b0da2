"""Target of the active explorer."""

import numpy as np
import pytest

from embodied_active_learning.config import Config
from embodied_active_learning.exploration.active import ActiveExplorer
from embodied_active_learning.exploration.samples import WorkspaceSamples

CONFIG = Config.from_dict({"exploration": {"samples": 500, "fresh_samples": 0}})
WORKSPACE = CONFIG.workspace.box()
CORNER = np.array([0.34, -0.13])


def target_of(visited=(), places=()):
    """Return sample positions (S, 2) [m] and the target (S,) after visiting positions with open places."""
    samples = WorkspaceSamples(CONFIG, WORKSPACE.normalise([[*place, 0.0] for place in visited]).reshape(-1, 3))
    samples.refresh()
    explorer = ActiveExplorer(CONFIG, 0)
    explorer.set_open_places(np.array(places))
    return WORKSPACE.denormalise(samples.states)[:, :2], explorer.target(samples)


def everywhere():
    return [(x, y) for x in np.linspace(0.325, 0.625, 7) for y in np.linspace(-0.15, 0.15, 7)]


def test_target_is_high_where_table_is_unseen():
    states, target = target_of(visited=[place for place in everywhere() if np.hypot(*(place - CORNER)) > 0.15])
    assert target.sum() == pytest.approx(1.0)
    near, far = np.hypot(*(states - CORNER).T) < 0.06, np.hypot(*(states - CORNER).T) > 0.25
    assert target[near].min() > 10.0 * target[far].max()


def test_target_is_high_at_open_place_of_seen_table():
    states, target = target_of(visited=everywhere(), places=[CORNER])
    near = np.hypot(*(states - CORNER).T) < CONFIG.identification.view_distance
    assert target[near].sum() > 0.95


def test_open_place_outside_is_viewed_from_nearest_state():
    states, target = target_of(visited=everywhere(), places=[(0.31, -0.17)])
    assert np.hypot(*(states[target.argmax()] - WORKSPACE.lower[:2])) < CONFIG.identification.view_distance


def test_target_is_uniform_without_open_decisions():
    _, target = target_of(visited=everywhere())
    np.testing.assert_allclose(target, 1.0 / len(target))
