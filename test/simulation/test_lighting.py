"""Lighting, motion blur and generated textures."""

import numpy as np
import pytest

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.simulation.lighting import LightField
from embodied_active_learning.simulation.placed_objects import Table
from embodied_active_learning.simulation.scene import Scene
from embodied_active_learning.simulation.table_textures import TEXTURE_KINDS, generate_texture
from embodied_active_learning.simulation.world import Lighting, World
from embodied_active_learning.simulation.world_settings import GeneratedTexture

CENTRE = (0.475, 0.0)
GREY = Table(CENTRE, (0.8, 0.8), colour=(0.4, 0.4, 0.4))
POSE = (*CENTRE, 0.0)


def render(pose=POSE, table=GREY, velocity=(0.0, 0.0, 0.0), **lighting):
    scene = Scene(World("test", (), table, lighting=Lighting(**lighting)), CameraConfig())
    image = scene.render(pose, velocity=velocity)
    scene.close()
    return image.astype(float)


def test_lighting_is_off_by_default():
    assert np.all(render() == 102.0)


def test_only_motion_blur_leaves_a_picture_as_it_is():
    picture = np.full((4, 5, 3), 100, np.uint8)
    matrix, camera = np.array([[9.0, 0.0, 2.0], [0.0, 9.0, 1.5], [0.0, 0.0, 1.0]]), np.eye(4)
    camera[:3, 3] = (*CENTRE, 0.3)
    assert LightField(Lighting(motion_blur=0.1), CENTRE).apply(picture, camera, matrix) is picture
    for values in ({"brightness": 0.5}, {"gradient": 1.0}, {"shadow": 0.5}, {"white_balance": (1.0, 1.0, 0.5)}):
        assert np.any(LightField(Lighting(**values), CENTRE).apply(picture, camera, matrix) != picture)


def test_brightness_and_white_balance_scale_the_image():
    image = render(brightness=0.5, white_balance=(1.2, 1.0, 0.8))
    np.testing.assert_allclose(image[0, 0], [61.0, 51.0, 41.0])
    assert render(brightness=4.0).max() == 255.0


@pytest.mark.parametrize("yaw", [0.0, 1.0, -2.5])
def test_gradient_belongs_to_the_table(yaw):
    """One per metre along +y: 10 cm further the image is 10 % brighter, whatever the camera's yaw."""
    middle = [
        render((0.475, y, yaw), gradient=1.0, gradient_direction=np.pi / 2)[89:91, 89:91].mean() for y in (0, 0.1)
    ]
    np.testing.assert_allclose(middle, [102.0, 112.2], atol=1.0)


def test_soft_shadow_is_at_its_place():
    values = {"shadow": 0.5, "shadow_centre": (0.5, 0.05), "shadow_radius": 0.03}
    assert render((0.5, 0.05, 0.7), **values)[89:91, 89:91].mean() == pytest.approx(51.0, abs=1.0)
    assert render((0.53, 0.05, 0.7), **values)[89:91, 89:91].mean() == pytest.approx(
        102.0 * (1.0 - 0.5 * np.exp(-0.5)), abs=1.0
    )
    assert render((0.35, -0.1, 0.7), **values)[89:91, 89:91].mean() == pytest.approx(102.0, abs=1.0)


def test_motion_blur_smooths_along_the_motion():
    table = Table(CENTRE, (0.8, 0.8), generated=GeneratedTexture("noise", 1))
    sharp = render(table=table)
    np.testing.assert_array_equal(render(table=table, velocity=(0.1, 0.0, 0.0)), sharp)
    np.testing.assert_array_equal(render(table=table, motion_blur=0.05), sharp)
    blurred = render(table=table, velocity=(0.1, 0.0, 0.0), motion_blur=0.15)
    remaining_y, remaining_x = (
        np.abs(np.diff(blurred, axis=axis)).mean() / np.abs(np.diff(sharp, axis=axis)).mean() for axis in (0, 1)
    )
    assert remaining_x < 0.8 * remaining_y
    assert remaining_x < 0.6
    np.testing.assert_allclose(blurred.mean(axis=(0, 1)), sharp.mean(axis=(0, 1)), atol=1.0)


@pytest.mark.parametrize("kind", TEXTURE_KINDS)
def test_textures_follow_from_their_seed(kind):
    first, second = generate_texture(kind, 0, 256), generate_texture(kind, 1, 256)
    assert first.shape == (256, 256, 3)
    assert first.dtype == np.uint8
    np.testing.assert_array_equal(generate_texture(kind, 0, 256), first)
    assert np.abs(first.astype(float) - second).mean() > 2.0
    assert first.std(axis=(0, 1)).min() > 0.5, "featureless"


def test_textures_of_a_kind_have_several_colours():
    means = np.array(
        [[generate_texture(kind, seed, 64).mean(axis=(0, 1)) for seed in range(6)] for kind in TEXTURE_KINDS]
    )
    assert np.all(np.ptp(means, axis=1).max(axis=-1) > 30.0)
