"""Velocity from measured poses, and poses that cannot be of one moving arm."""

import math

import numpy as np
import pytest

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.franka.mount import CameraPose
from embodied_active_learning.franka.state_track import StateTrack

CONFIG = Config.from_dict({"arm": {"robot": "franka"}})
PERIOD = 1.0 / 30.0
LEVEL = (0.0, 0.0)


def at(x, y=0.0, theta=0.0, height=0.0, tilt=LEVEL):
    return CameraPose((x, y, theta), height, tilt)


def moved(speed, stamps, track=None):
    """A track of an arm that goes along x from 0.4 m at a speed, seen at these stamps."""
    track = track or StateTrack(CONFIG)
    for stamp in stamps:
        track.add(stamp, at(0.4 + speed * stamp))
    return track


def test_a_steady_motion_has_its_velocity_after_a_few_states():
    track = moved(0.1, np.arange(20) * PERIOD)
    np.testing.assert_allclose(track.velocity, [0.1, 0.0, 0.0], atol=1e-6)


def test_states_that_are_sent_again_change_nothing():
    stamps = np.arange(20) * PERIOD
    once, again = moved(0.1, stamps), moved(0.1, np.repeat(stamps, 3))
    assert again.velocity == pytest.approx(once.velocity)
    assert not again.is_new(stamps[-1])


def test_jitter_of_the_stamps_hardly_shows_in_the_velocity():
    generator = np.random.default_rng(0)
    track = StateTrack(CONFIG)
    speeds = []
    for number in range(300):
        stamp = 0.01 * number
        track.add(stamp + generator.uniform(-0.002, 0.002), at(0.4 + 0.1 * stamp))
        speeds.append(track.velocity[0])
    assert np.abs(np.array(speeds[50:]) - 0.1).max() < 0.03


def test_states_that_come_closer_than_a_stamp_is_exact_are_not_differenced_alone():
    track = moved(0.1, [0.0, 0.01, 0.02, 0.03])
    track.add(0.0301, at(0.4 + 0.1 * 0.03 + 0.001))
    assert track.velocity[0] < 0.11


def test_a_silence_leaves_no_velocity_from_before():
    track = moved(0.1, [0.0, 0.1])
    assert track.velocity[0] > 0.0
    track.add(2.0, at(0.41))
    assert track.velocity == (0.0, 0.0, 0.0)


def test_a_velocity_tells_rest_only_after_poses_that_followed_each_other_for_a_while():
    track = moved(0.1, [0.0])
    assert not track.tells_motion
    moved(0.1, np.arange(1, 5) * PERIOD, track)
    assert track.tells_motion
    with pytest.raises(ObservationError):
        track.add(5 * PERIOD, at(0.6))
    assert not track.tells_motion


def test_a_pose_that_jumps_is_told_and_begins_the_track_anew():
    track = moved(0.1, np.arange(10) * PERIOD)
    with pytest.raises(ObservationError, match=r"jumped by 0\.170 m"):
        track.add(10 * PERIOD, at(0.6))
    assert track.velocity == (0.0, 0.0, 0.0)
    assert track.pose.planar[0] == 0.6
    track.add(11 * PERIOD, at(0.6))


@pytest.mark.parametrize("pose", [at(0.4, height=0.1), at(0.4, theta=0.6), at(0.4, tilt=(0.4, 0.0))])
def test_height_yaw_and_tilt_may_not_jump_either(pose):
    track = StateTrack(CONFIG)
    track.add(0.0, at(0.4))
    with pytest.raises(ObservationError, match="jumped"):
        track.add(PERIOD, pose)


def test_time_that_goes_back_is_told():
    track = moved(0.1, [1.0, 1.1])
    with pytest.raises(ObservationError, match=r"went back by 0\.600 s"):
        track.add(0.5, at(0.4))


def test_yaw_goes_on_beyond_pi_where_the_arm_does():
    track = StateTrack(CONFIG)
    for number, theta in enumerate([3.10, 3.13, 3.16 - 2.0 * math.pi]):
        track.add(0.1 * number, at(0.4, theta=theta))
    assert track.pose.planar[2] == pytest.approx(3.16)
    assert 0.0 < track.velocity[2] < 0.31
