"""PosedCamera: which images are paired with which state, and why the others are rejected; without a master."""

import threading

import numpy as np
import pytest
import rospy

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.ros.camera.posed_camera import PosedCamera
from embodied_active_learning.ros.conversions import image_array, image_message, state_arrays, state_message

CAMERA = {"width": 8, "height": 8, "max_age": 0.05}
HERE, THERE = (0.5, 0.0, 0.0), (0.52, 0.0, 0.0)
MAX_AGE = r"camera/max_age .*0\.05 s"


class Scene:
    """A clock, a camera and an arm whose messages are sent by the test. Every picture differs."""

    def __init__(self, **camera):
        self.now = 100.0
        self.pictures = np.random.default_rng(0)
        config = Config.from_dict({"camera": {**CAMERA, **camera}, "arm": {"robot": "franka"}})
        self.arrives_during_take = []  # stamps of images that arrive while take() waits
        self.camera = PosedCamera(config, clock=self.read_clock)

    def read_clock(self):
        if self.arrives_during_take:
            self.sees(stamp=self.arrives_during_take.pop())
        return rospy.Time(self.now)

    def moves_to(self, pose, stamp=None):
        self.camera.add_state(state_message(self.time(stamp), pose, (0.0, 0.0, 0.0)))

    def sees(self, picture=None, stamp=None):
        picture = self.picture() if picture is None else picture
        self.camera.add_image(image_message(self.time(stamp), picture))
        return picture

    def picture(self):
        return self.pictures.integers(0, 256, (8, 8, 3), dtype=np.uint8)

    def step(self, pose, picture=None):
        """Advance half a second, move the arm to a pose and send a picture -> the picture."""
        self.now += 0.5
        self.moves_to(pose)
        return self.sees(picture)

    def take(self, after=None):
        image, state = self.camera.take(self.time(after))
        return image.header.stamp, image_array(image, 8, 8), state

    def time(self, stamp):
        return rospy.Time.from_sec(self.now if stamp is None else stamp)


@pytest.fixture
def scene():
    return Scene()


def rejection(scene, after=None):
    with pytest.raises(ObservationError) as error:
        scene.take(after)
    return str(error.value)


def check_rejected(scene, words, after=None):
    assert words in rejection(scene, after)


def test_image_is_paired_with_state_at_its_stamp(scene):
    picture = scene.step(HERE)
    stamp, image, state = scene.take()
    assert stamp == rospy.Time(scene.now)
    np.testing.assert_array_equal(image, picture)
    np.testing.assert_allclose(state_arrays(state)[0], HERE)


def test_state_is_interpolated_along_shorter_yaw(scene):
    scene.moves_to((0.5, 0.0, 3.1), stamp=100.00)
    scene.moves_to((0.502, 0.0, -3.1), stamp=100.04)
    scene.now = 100.04
    scene.sees(stamp=100.01)
    _, _, state = scene.take(after=100.0)
    np.testing.assert_allclose(state_arrays(state)[0], (0.5005, 0.0, 3.1 + 0.25 * (2.0 * np.pi - 6.2)), atol=1e-9)


def test_take_waits_for_fresh_image():
    scene = Scene(max_age=10.0)
    scene.step(HERE)
    scene.take()
    after = scene.now + 0.4
    threading.Timer(0.05, scene.step, [THERE]).start()
    _, _, state = scene.take(after)
    assert state.x == THERE[0]


def test_camera_without_images_is_reported(scene):
    scene.moves_to(HERE)
    check_rejected(scene, "no image on /camera/image_raw yet")


def test_camera_timeout_is_reported(scene):
    scene.step(HERE)
    scene.take()
    scene.now += 0.5
    scene.moves_to(THERE)
    check_rejected(
        scene,
        "camera timeout: no new image on /camera/image_raw within camera/max_age (0.05 s), the newest is 0.50 s old",
    )


def test_camera_repeating_one_stamp_is_reported_as_frozen(scene):
    scene.step(HERE)
    scene.take()
    for _ in range(2):
        scene.now += 0.5
        scene.moves_to(HERE)
        scene.sees(stamp=100.5)
        check_rejected(
            scene, "images on /camera/image_raw repeat one stamp, 100.500 s: the camera or its driver is frozen"
        )


def test_stamp_is_used_once_while_time_stands_still(scene):
    scene.step(HERE)
    scene.take()
    scene.sees()
    check_rejected(scene, "one stamp")


def test_images_older_than_max_age_are_rejected(scene):
    scene.moves_to(HERE, stamp=100.0)
    scene.sees(stamp=100.0)
    scene.now = 101.5
    check_rejected(scene, "are late: the newest is 1.50 s old, camera/max_age is 0.05 s", after=100.0)


def test_late_images_are_rejected():
    scene = Scene(max_age=0.5)
    scene.moves_to(HERE, stamp=100.0)
    scene.moves_to(HERE, stamp=101.0)
    scene.now = 101.0
    scene.arrives_during_take.append(100.2)
    check_rejected(scene, "are late: the newest is 0.80 s old, camera/max_age is 0.5 s")


def test_images_from_the_future_are_rejected(scene):
    scene.moves_to(HERE)
    scene.sees(stamp=scene.now + 2.0)
    scene.moves_to(HERE, stamp=scene.now + 2.0)
    check_rejected(scene, "is stamped 2.00 s in the future")


def test_unstamped_images_are_reported(scene):
    scene.moves_to(HERE)
    scene.sees(stamp=0.0)
    check_rejected(scene, "images on /camera/image_raw have no time stamp (header.stamp is 0)")


def test_image_before_its_clock_message_is_accepted(scene):
    scene.moves_to(HERE, stamp=100.5)
    scene.sees(stamp=100.5)
    stamp, _, _ = scene.take(after=100.5)
    assert stamp.to_sec() == 100.5


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda image: setattr(image, "encoding", "mono8"), "encoding is 'mono8'"),
        (lambda image: setattr(image, "width", 16), "16 x 8 pixels"),
        (lambda image: setattr(image, "step", 7), "rows of 7"),
        (lambda image: setattr(image, "data", b""), "0 bytes"),
    ],
)
def test_malformed_image_is_rejected_and_next_accepted(scene, spoil, words):
    scene.moves_to(HERE)
    image = image_message(scene.time(None), scene.picture())
    spoil(image)
    scene.camera.add_image(image)
    check_rejected(scene, words)
    scene.step(HERE)
    scene.take()


def test_image_of_one_colour_is_rejected(scene):
    scene.step(HERE, np.zeros((8, 8, 3), np.uint8))
    message = rejection(scene)
    assert "has a single colour, [0, 0, 0]" in message
    assert "camera/allow_featureless" in message
    scene.step(HERE)
    scene.take()


def test_image_of_one_colour_is_accepted_if_allowed():
    scene, plain = Scene(allow_featureless=True), np.full((8, 8, 3), 7, np.uint8)
    for pose in (HERE, THERE):
        scene.step(pose, plain)
        scene.take()
    picture = scene.step(HERE)
    scene.take()
    scene.step(THERE, picture)
    check_rejected(scene, "is the same as from")


def test_identical_image_from_other_pose_is_rejected(scene):
    picture = scene.step(HERE)
    scene.take()
    scene.step(THERE, picture)
    check_rejected(scene, "the image on /camera/image_raw is the same as from x 0.500 m, y 0.000 m, theta 0.00 rad")
    scene.step(THERE, picture)
    check_rejected(scene, "is the same as from")
    for _ in range(3):
        scene.step(THERE, picture)
        message = rejection(scene)
        assert "have been byte-identical since the arm was at x 0.500 m, y 0.000 m, theta 0.00 rad" in message
        assert "camera frozen" in message
    scene.step(THERE)
    scene.take()
    scene.step(HERE, picture)
    scene.take()


@pytest.mark.parametrize(("pose", "moved"), [((0.5005, 0.0, 0.005), False), ((0.5015, 0, 0), True), (THERE, True)])
def test_camera_at_rest_may_repeat_its_image(scene, pose, moved):
    """Within STILL_DISTANCE and STILL_TURN."""
    picture = scene.step(HERE)
    scene.take()
    scene.step(pose, picture)
    if moved:
        check_rejected(scene, "is the same as from")
    else:
        scene.take()


def test_slow_drift_is_measured_from_first_sight(scene):
    picture = scene.step(HERE)
    for x in (0.5004, 0.5008):
        scene.step((x, 0.0, 0.0), picture)
        scene.take()
    scene.step((0.5012, 0.0, 0.0), picture)
    check_rejected(scene, "is the same as from x 0.500 m")


def test_camera_frozen_between_two_attempts_is_detected(scene):
    scene.step(HERE)
    scene.take()
    picture = scene.step((0.51, 0.0, 0.0))
    scene.step(THERE, picture)
    check_rejected(scene, "is the same as from x 0.510 m")


@pytest.mark.parametrize("wrong", [{"stamp": 100.6}, {"stamp": 110.0}])
def test_origin_ignores_implausible_first_stamp(scene, wrong):
    """An image is seen first with a stamp from the future, then with plausible ones."""
    scene.step(HERE)
    scene.take()
    scene.moves_to(HERE, stamp=100.6)
    scene.now = 101.0
    scene.moves_to(THERE)
    picture = scene.sees(**wrong)
    rejection(scene)
    scene.step(THERE, picture)
    scene.take()


def test_origin_ignores_stamp_of_previous_image(scene):
    """An image arrives first with the stamp of the image before it."""
    scene.step(HERE)
    scene.take()
    near = (0.502, 0.0, 0.0)
    scene.now += 0.04
    scene.moves_to(near)
    picture = scene.sees(stamp=100.5)
    check_rejected(scene, "one stamp")
    scene.now += 0.01
    scene.moves_to(near)
    scene.sees(picture)
    scene.take()


def test_origin_ignores_state_before_a_jump(scene):
    """An image is first seen while the pose is wrong."""
    scene.step(HERE)
    scene.take()
    scene.now += 0.01
    scene.moves_to((0.6, 0.0, 0.0))
    picture = scene.sees()
    check_rejected(scene, "pose jump")
    for _ in range(2):
        scene.now += 0.01
        scene.moves_to(HERE)
        scene.sees(picture)
    check_rejected(scene, "pose jump")
    scene.take()


def test_origin_without_state_is_that_of_first_use(scene):
    picture = scene.sees()
    scene.step(HERE, picture)
    scene.take()
    scene.step(THERE, picture)
    check_rejected(scene, "is the same as from x 0.500 m")


def test_missing_state_is_reported(scene):
    scene.sees()
    check_rejected(scene, "no state on /arm/state around the image's stamp: none was received")


def test_state_timeout_is_reported(scene):
    scene.step(HERE)
    scene.take()
    scene.now += 0.5
    scene.sees()
    message = rejection(scene)
    assert "no state on /arm/state around the image's stamp: the newest is 0.50 s older than the image" in message
    assert "camera/max_age (0.05 s)" in message


def test_state_repeating_one_stamp_is_reported(scene):
    scene.step(HERE)
    scene.take()
    scene.moves_to(HERE)
    scene.now += 0.5
    scene.sees()
    check_rejected(scene, "they repeat one stamp, 100.500 s")


def test_first_state_of_a_stamp_is_used(scene):
    scene.moves_to(HERE)
    scene.moves_to((0.504, 0.0, 0.0))
    scene.sees()
    assert scene.take()[2].x == HERE[0]


def test_state_is_not_interpolated_across_a_gap(scene):
    scene.moves_to(HERE, stamp=100.0)
    scene.moves_to(THERE, stamp=100.2)
    scene.now = 100.12
    scene.sees(stamp=100.1)
    check_rejected(scene, "no state on /arm/state for 0.20 s around the image's stamp", after=100.05)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_non_finite_state_is_rejected(scene, value):
    """Nor are states interpolated across it."""
    scene.moves_to(HERE, stamp=100.0)
    scene.moves_to((0.5, value, 0.0), stamp=100.01)
    scene.sees(stamp=100.01)
    check_rejected(scene, "invalid state on /arm/state: non-finite values")
    scene.moves_to(HERE, stamp=100.02)
    check_rejected(scene, "the oldest is 0.01 s newer than the image")


def test_pose_jump_is_reported_once(scene):
    """Afterwards the new track is used."""
    scene.moves_to(HERE, stamp=100.00)
    scene.moves_to((0.6, 0.0, 0.0), stamp=100.02)
    scene.sees(stamp=100.01)
    message = rejection(scene)
    assert "pose jump on /arm/state: 0.100 m and 0.00 rad in 0.020 s, faster than arm/max_speed" in message
    check_rejected(scene, "the oldest is 0.01 s newer than the image")
    scene.step((0.6, 0.0, 0.0))
    _, _, state = scene.take()
    assert state.x == 0.6


def test_impossible_turn_is_a_jump(scene):
    scene.step(HERE)
    scene.step((0.5, 0.0, 2.9))
    check_rejected(scene, "pose jump on /arm/state: 0.000 m and 2.90 rad")


def test_motion_at_speed_limit_is_not_a_jump(scene):
    limits = Config().arm
    for step in range(20):
        scene.now += 0.01
        share = 0.01 * step
        scene.moves_to((0.4 + share * limits.max_speed, share * limits.max_speed, share * limits.max_turn_rate))
    scene.sees()
    scene.take()


def test_clock_going_back_resets_the_buffers(scene):
    """A restarted simulation neither jumps nor has a frozen camera."""
    picture = scene.step(HERE)
    scene.take()
    scene.now = 5.0
    check_rejected(scene, "in the future", after=0.0)
    scene.moves_to((0.6, 0.1, 1.0))
    check_rejected(scene, "in the future", after=0.0)
    scene.sees(picture)
    stamp, _, state = scene.take()
    assert (stamp.to_sec(), state.x) == (5.0, 0.6), "the clock reset was taken for a jump or a frozen camera"


def test_state_is_not_interpolated_across_clock_reset(scene):
    scene.moves_to(HERE, stamp=100.0)
    scene.moves_to(HERE, stamp=99.98)
    scene.now = 99.99
    scene.sees()
    check_rejected(scene, "the newest is 0.01 s older than the image")


def test_latency_pairs_image_with_pose_of_its_exposure():
    """The stamp is late by camera/latency; freshness counts from the exposure."""
    scene = Scene(latency=0.2, max_age=0.6)
    for x in (0.400, 0.401, 0.402):
        scene.step((x, 0.0, 0.0))
    stamp, _, state = scene.take(after=scene.now - 0.3)
    assert stamp.to_sec() == pytest.approx(scene.now - 0.2)
    assert state.x == pytest.approx(0.4016)
    scene.sees()
    with pytest.raises(ObservationError):
        scene.take(after=scene.now - 0.1)
