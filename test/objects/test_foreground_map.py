"""Visible things in images of a painted table."""

import numpy as np
import pytest

from embodied_active_learning.config import Config
from embodied_active_learning.objects.foreground_map import map_foreground
from embodied_active_learning.objects.salience import Background
from painted_table import Thing, paint, random_states

CONFIG = Config.from_dict({"camera": {"width": 45, "height": 45}, "fingerprint": {"prints": True}})


@pytest.mark.parametrize("places", [(), ((0.40, -0.07),), ((0.40, -0.07), (0.54, 0.06), (0.60, -0.12))])
def test_things_are_found_at_their_places(places):
    things = [Thing(index, (*place, 0.5)) for index, place in enumerate(places)]
    states = random_states(CONFIG.workspace.box(), 120)
    images = paint(states, things, CONFIG.camera, noise=8.0)
    found = map_foreground(states, images, Background(images), CONFIG).things
    assert len(found) == len(places)
    for place in places:
        assert np.hypot(*(found - place).T).min() < 0.01


def test_touching_things_are_separated():
    """The region of two things has its middle between them, far from both."""
    places = (0.435, 0.0), (0.515, 0.0)
    things = [Thing(index, (*place, 0.5), 0.04) for index, place in enumerate(places)]
    states = random_states(CONFIG.workspace.box(), 120)
    bare = Background(paint(states, [], CONFIG.camera, noise=8.0))
    found = map_foreground(states, paint(states, things, CONFIG.camera, noise=8.0), bare, CONFIG).things
    assert len(found) == 2
    for place in places:
        assert np.hypot(*(found - place).T).min() < 0.01


def test_thing_beside_print_is_separated_from_it():
    """Colours alone show one region, with its middle between them."""
    config = Config.from_dict({"camera": {"width": 90, "height": 90}})
    thing, flat = Thing(0, (0.44, 0.0, 0.5), 0.025, 0.03), Thing(1, (0.485, 0.0, 0.5), 0.025)
    states = random_states(config.workspace.box(), 300)
    images = paint(states, [flat, thing], config.camera)
    found = map_foreground(states, images, Background(images), config)
    assert len(found.things) == len(found.prints) == 1
    assert np.hypot(*(found.things[0] - thing.pose[:2])) < 0.015
    assert np.hypot(*(found.prints[0] - flat.pose[:2])) < 0.02
    places = np.array([thing.pose[:2], flat.pose[:2], (0.60, 0.10), (9.0, 9.0)])
    assert found.stands_at(places + np.array([0.01, 0.0])).tolist() == [True, False, False, False]


def test_place_of_unknown_height_is_a_thing():
    """Such as one that few images show."""
    config = Config.from_dict({"camera": {"width": 90, "height": 90}})
    flat = Thing(1, (0.485, 0.0, 0.5), 0.025)
    states = random_states(config.workspace.box(), 20)
    images = paint(states, [flat], config.camera)
    found = map_foreground(states, images, Background(images), config)
    assert len(found.things) == 1
    assert len(found.prints) == 0


def test_wrong_states_do_not_hide_things():
    """The images then fit no plane, so that parts of everything seem to be raised."""
    config = Config.from_dict({"camera": {"width": 90, "height": 90}})
    states = random_states(config.workspace.box(), 300)
    images = paint(states, [Thing(0, (0.44, 0.0, 0.5), 0.025, 0.03)], config.camera)
    wrong = states + np.random.default_rng(1).normal(0.0, (0.004, 0.004, 0.03), states.shape)
    found = map_foreground(wrong, images, Background(images), config)
    assert len(found.things) == 1
    assert len(found.prints) == 0
