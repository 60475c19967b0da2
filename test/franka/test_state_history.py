"""Velocity from measured poses, and jumps between them."""

import math

import numpy as np
import pytest

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.franka.mount import CameraPose
from embodied_active_learning.franka.state_history import StateHistory

CONFIG = Config.from_dict({"arm": {"robot": "franka"}})
PERIOD = 1.0 / 30.0
LEVEL = (0.0, 0.0)


def at(x, y=0.0, theta=0.0, height=0.0, tilt=LEVEL):
    return CameraPose((x, y, theta), height, tilt)


def moved(speed, stamps, history=None):
    """The history of an arm that moves along x from 0.4 m at a speed, sampled at these stamps."""
    history = history or StateHistory(CONFIG)
    for stamp in stamps:
        history.add(stamp, at(0.4 + speed * stamp))
    return history


def test_velocity_of_steady_motion_converges():
    history = moved(0.1, np.arange(20) * PERIOD)
    np.testing.assert_allclose(history.velocity, [0.1, 0.0, 0.0], atol=1e-6)


def test_repeated_states_are_ignored():
    stamps = np.arange(20) * PERIOD
    once, again = moved(0.1, stamps), moved(0.1, np.repeat(stamps, 3))
    assert again.velocity == pytest.approx(once.velocity)
    assert not again.is_new(stamps[-1])


def test_stamp_jitter_is_filtered():
    generator = np.random.default_rng(0)
    history = StateHistory(CONFIG)
    speeds = []
    for number in range(300):
        stamp = 0.01 * number
        history.add(stamp + generator.uniform(-0.002, 0.002), at(0.4 + 0.1 * stamp))
        speeds.append(history.velocity[0])
    assert np.abs(np.array(speeds[50:]) - 0.1).max() < 0.03


def test_states_closer_than_stamp_accuracy_are_not_differenced():
    history = moved(0.1, [0.0, 0.01, 0.02, 0.03])
    history.add(0.0301, at(0.4 + 0.1 * 0.03 + 0.001))
    assert history.velocity[0] < 0.11


def test_gap_resets_velocity():
    history = moved(0.1, [0.0, 0.1])
    assert history.velocity[0] > 0.0
    history.add(2.0, at(0.41))
    assert history.velocity == (0.0, 0.0, 0.0)


def test_velocity_is_known_after_continuous_poses():
    history = moved(0.1, [0.0])
    assert not history.is_velocity_known
    moved(0.1, np.arange(1, 5) * PERIOD, history)
    assert history.is_velocity_known
    with pytest.raises(ObservationError):
        history.add(5 * PERIOD, at(0.6))
    assert not history.is_velocity_known


def test_pose_jump_raises_and_restarts_history():
    history = moved(0.1, np.arange(10) * PERIOD)
    with pytest.raises(ObservationError, match=r"jumped by 0\.170 m"):
        history.add(10 * PERIOD, at(0.6))
    assert history.velocity == (0.0, 0.0, 0.0)
    assert history.pose.planar[0] == 0.6
    history.add(11 * PERIOD, at(0.6))


@pytest.mark.parametrize("pose", [at(0.4, height=0.1), at(0.4, theta=0.6), at(0.4, tilt=(0.4, 0.0))])
def test_jump_of_height_yaw_or_tilt_raises(pose):
    history = StateHistory(CONFIG)
    history.add(0.0, at(0.4))
    with pytest.raises(ObservationError, match="jumped"):
        history.add(PERIOD, pose)


def test_stamp_going_back_raises():
    history = moved(0.1, [1.0, 1.1])
    with pytest.raises(ObservationError, match=r"went back by 0\.600 s"):
        history.add(0.5, at(0.4))


def test_yaw_is_unwrapped_beyond_pi():
    history = StateHistory(CONFIG)
    for number, theta in enumerate([3.10, 3.13, 3.16 - 2.0 * math.pi]):
        history.add(0.1 * number, at(0.4, theta=theta))
    assert history.pose.planar[2] == pytest.approx(3.16)
    assert 0.0 < history.velocity[2] < 0.31
