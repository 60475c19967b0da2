"""Colour features and the correction of noise."""

from __future__ import annotations

import numpy as np
import pytest

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.objects.colours import blurred, noise_level

CAMERA = CameraConfig()
YELLOW = (120, 100, 3)


def noisy(colour, std: float) -> np.ndarray:
    """An image of one colour as a camera with noise shows it."""
    noise = np.random.default_rng(0).normal(0.0, std, (CAMERA.height, CAMERA.width, 3))
    return np.clip(np.rint(np.asarray(colour) + noise), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("colour", [YELLOW, (252, 200, 128)])
def test_noise_does_not_change_mean_colour(colour):
    """Without correction, noise of 10 raises a channel of 3 to 6 and lowers one of 252 to 249."""
    assert blurred(noisy(colour, 10.0), CAMERA).mean(axis=(0, 1)) == pytest.approx(colour, abs=1.0)


def test_image_without_noise_keeps_its_colours():
    assert (blurred(noisy(YELLOW, 0.0), CAMERA) == YELLOW).all()


@pytest.mark.parametrize("std", [2.0, 5.0, 10.0])
def test_noise_level_is_measured(std):
    assert noise_level(noisy((120, 100, 80), std)) == pytest.approx(std, rel=0.15)


def test_edges_are_not_taken_for_noise():
    image = noisy(YELLOW, 0.0)
    image[::9, ::7] = 255
    assert noise_level(image) == 0.0
