"""Camera latency from images and poses: synthetic rotations, and once the simulated arm and camera."""

import cv2
import numpy as np
import pytest

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.franka.latency import RotationTracker, estimate_latency
from embodied_active_learning.simulation.simulation import Simulation
from embodied_active_learning.simulation.world import load_world

TOLERANCE = 0.005  # s
RATE = 0.3  # rad/s


def triangle(times):
    """Yaw that turns at a constant rate and reverses every 2 s."""
    phase = np.mod(times, 4.0)
    return RATE * np.where(phase < 2.0, phase, 4.0 - phase)


@pytest.fixture
def texture():
    generator = np.random.default_rng(0)
    return cv2.GaussianBlur(generator.uniform(0, 255, (181, 181)).astype(np.float32), (0, 0), 3.0)


def rotated(image, angle):
    height, width = image.shape
    matrix = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), np.degrees(angle), 1.0)
    return cv2.warpAffine(image, matrix, (width, height), borderMode=cv2.BORDER_REFLECT)


@pytest.mark.parametrize("angle", [0.0, 0.01, -0.2, 0.6])
def test_tracker_measures_rotation(texture, angle):
    tracker = RotationTracker()
    tracker.rotation(texture)
    assert tracker.rotation(rotated(texture, -angle)) == pytest.approx(angle, abs=3e-3)


@pytest.mark.parametrize("latency", [0.0, 0.033, 0.1, 0.25])
def test_latency_of_synthetic_images(texture, latency):
    """Images at 30 Hz that show the yaw of `latency` ago; poses at 100 Hz with noise."""
    generator = np.random.default_rng(1)
    stamps, times = np.arange(0.0, 10.0, 1 / 30), np.arange(0.0, 10.0, 0.01)
    tracker = RotationTracker()
    rotations = [tracker.rotation(rotated(texture, triangle(stamp - latency))) for stamp in stamps]
    yaws = triangle(times) + generator.normal(0.0, 1e-3, len(times))
    estimate = estimate_latency(stamps, rotations, times, yaws)
    assert estimate.latency == pytest.approx(latency, abs=TOLERANCE)
    assert estimate.std_error < TOLERANCE


def test_latency_of_simulated_camera():
    config = Config()
    latency, period = 0.067, 1.0 / 30.0
    stamps, rotations, times, yaws = [], [], [], []
    tracker = RotationTracker()
    with Simulation(load_world("diagonal", config.workspace.box()), config) as simulation:
        for sweep in (1.0, -1.0, 1.0):
            for _ in range(40):
                simulation.move((0.0, 0.0, sweep * RATE), period)
                times.append(simulation.time)
                yaws.append(simulation.pose[2])
                stamps.append(simulation.time + latency)
                rotations.append(tracker.rotation(simulation.image()))
    estimate = estimate_latency(stamps, rotations, times, yaws)
    assert estimate.latency == pytest.approx(latency, abs=TOLERANCE)


def test_constant_yaw_is_rejected():
    stamps = np.arange(0.0, 5.0, 0.1)
    with pytest.raises(ObservationError, match="turned by less than"):
        estimate_latency(stamps, 0.0 * stamps, stamps, 0.0 * stamps)


def test_too_few_images_are_rejected():
    with pytest.raises(ObservationError, match="only 0 images"):
        estimate_latency([], [], [0.0, 1.0], [0.0, 1.0])


def test_rotation_unrelated_to_yaw_is_rejected():
    stamps = np.arange(0.0, 10.0, 0.1)
    noise = np.random.default_rng(2).normal(0.0, 0.3, len(stamps))
    with pytest.raises(ObservationError, match=r"deviates from the measured yaw|fits"):
        estimate_latency(stamps, noise, stamps, triangle(stamps))
