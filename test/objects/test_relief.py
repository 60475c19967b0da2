"""Relief of painted discs, with and without height above the table."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from embodied_active_learning.config import CameraConfig, Config
from embodied_active_learning.objects.relief import relief_at
from painted_table import Thing, paint

CONFIG = Config.from_dict({"camera": {"width": 90, "height": 90}})
PLACE = np.array([0.47, 0.02])


def near_states(count, seed=0):
    around = np.array([*PLACE, 0.0])
    return around + np.random.default_rng(seed).uniform(-1.0, 1.0, (count, 3)) * (0.05, 0.05, 2.0)


def measured(height, noise=3.0, brightness=1.0, count=24):
    states = near_states(count)
    images = paint(states, [Thing(0, (*PLACE, 0.4), height=height)], CONFIG.camera, noise)
    return relief_at(PLACE, states, (brightness * images).astype(np.uint8), CONFIG.camera)


def test_print_is_in_table_plane():
    assert measured(0.0).in_table_plane


@settings(max_examples=15)
@given(height=st.floats(0.01, 0.05), brightness=st.floats(0.5, 1.0))
def test_standing_disc_is_raised_in_any_light(height, brightness):
    found = measured(height, brightness=brightness)
    assert not found.in_table_plane
    assert found.area > 3e-4


def test_wrong_states_do_not_make_things_flat():
    """The images then fit neither the plane of the table nor another one, so nothing is known."""
    states = near_states(24)
    images = paint(states, [Thing(0, (*PLACE, 0.4))], CONFIG.camera)
    wrong = states + np.random.default_rng(1).normal(0.0, (0.006, 0.006, 0.05), states.shape)
    assert not relief_at(PLACE, wrong, images, CONFIG.camera).in_table_plane


def test_low_camera_measures_lower_planes():
    camera = CameraConfig(width=90, height=90, distance=0.05)
    states = near_states(24)
    found = relief_at(PLACE, states, paint(states, [], camera), camera)
    assert found is not None
    assert not found.raised.any()


def test_relief_needs_eight_images_of_the_place():
    states = np.concatenate([near_states(7), near_states(20) + np.array([0.1, 0.1, 0.0])])
    images = paint(states, [Thing(0, (*PLACE, 0.4))], CONFIG.camera)
    assert relief_at(PLACE, states, images, CONFIG.camera) is None
    assert relief_at(PLACE, states[:0], images[:0], CONFIG.camera) is None
    one_more = np.concatenate([states, near_states(1, seed=1)])
    assert relief_at(PLACE, one_more, paint(one_more, [], CONFIG.camera), CONFIG.camera) is not None


def test_relief_needs_images_from_different_places():
    """From one place, what has a height looks like a print."""
    states = near_states(24) * (0.1, 0.1, 1.0) + 0.9 * np.array([*PLACE, 0.0])
    images = paint(states, [Thing(0, (*PLACE, 0.4), height=0.03)], CONFIG.camera)
    assert relief_at(PLACE, states, images, CONFIG.camera) is None


def test_points_beside_a_standing_disc_are_flat():
    states = near_states(24)
    images = paint(states, [Thing(0, (*PLACE, 0.4), radius=0.015, height=0.03)], CONFIG.camera)
    found = relief_at(PLACE, states, images, CONFIG.camera)
    disc = np.random.default_rng(0).uniform(-0.008, 0.008, (100, 2))
    assert not found.in_table_plane
    assert not found.is_in_table_plane(PLACE + disc)
    assert found.is_in_table_plane(PLACE + 0.024 + 0.2 * disc)
    assert not found.is_in_table_plane(PLACE + 0.1 + disc), "nothing is known beyond the map"
