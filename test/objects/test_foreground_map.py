"""Visible things in images of a painted table."""

import numpy as np
import pytest

from embodied_active_learning.config import Config
from embodied_active_learning.objects.foreground_map import visible_things
from embodied_active_learning.objects.salience import Background
from painted_table import Thing, paint, random_states

CONFIG = Config.from_dict({"camera": {"width": 45, "height": 45}})


@pytest.mark.parametrize("places", [(), ((0.40, -0.07),), ((0.40, -0.07), (0.54, 0.06), (0.60, -0.12))])
def test_things_are_found_at_their_places(places):
    things = [Thing(index, (*place, 0.5)) for index, place in enumerate(places)]
    states = random_states(CONFIG.workspace.box(), 120)
    images = paint(states, things, CONFIG.camera, noise=8.0)
    found = visible_things(states, images, Background(images), CONFIG)
    assert len(found) == len(places)
    for place in places:
        assert np.hypot(*(found - place).T).min() < 0.01


def test_touching_things_are_separated():
    """The region of two things has its middle between them, far from both."""
    places = (0.435, 0.0), (0.515, 0.0)
    things = [Thing(index, (*place, 0.5), 0.04) for index, place in enumerate(places)]
    states = random_states(CONFIG.workspace.box(), 120)
    bare = Background(paint(states, [], CONFIG.camera, noise=8.0))
    found = visible_things(states, paint(states, things, CONFIG.camera, noise=8.0), bare, CONFIG)
    assert len(found) == 2
    for place in places:
        assert np.hypot(*(found - place).T).min() < 0.01
