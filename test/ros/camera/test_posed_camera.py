"""Which images are handed out with which state, and what is said about the others; without a master."""

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
    """A clock, a camera and an arm whose messages arrive when a test says so. Every picture is another one."""

    def __init__(self, **camera):
        self.now = 100.0
        self.pictures = np.random.default_rng(0)
        config = Config.from_dict({"camera": {**CAMERA, **camera}})
        self.camera = PosedCamera(config, clock=lambda: rospy.Time(self.now))

    def moves_to(self, pose, stamp=None):
        self.camera.add_state(state_message(self.time(stamp), pose, (0.0, 0.0, 0.0)))

    def sees(self, picture=None, stamp=None):
        picture = self.picture() if picture is None else picture
        self.camera.add_image(image_message(self.time(stamp), picture))
        return picture

    def picture(self):
        return self.pictures.integers(0, 256, (8, 8, 3), dtype=np.uint8)

    def step(self, pose, picture=None):
        """Half a second later the arm is at a pose, and the camera sees something there -> what."""
        self.now += 0.5
        self.moves_to(pose)
        return self.sees(picture)

    def look(self, after=None):
        image, state = self.camera.take(self.time(after))
        return image.header.stamp, image_array(image, 8, 8), state

    def time(self, stamp):
        return rospy.Time.from_sec(self.now if stamp is None else stamp)


@pytest.fixture
def scene():
    return Scene()


def refusal(scene, after=None):
    with pytest.raises(ObservationError) as error:
        scene.look(after)
    return str(error.value)


def check_refused(scene, words, after=None):
    assert words in refusal(scene, after)


def test_an_image_is_handed_out_with_the_state_at_its_stamp(scene):
    picture = scene.step(HERE)
    stamp, image, state = scene.look()
    assert stamp == rospy.Time(scene.now)
    np.testing.assert_array_equal(image, picture)
    np.testing.assert_allclose(state_arrays(state)[0], HERE)


def test_between_two_states_it_is_interpolated_with_the_yaw_the_short_way_round(scene):
    scene.moves_to((0.5, 0.0, 3.1), stamp=100.00)
    scene.moves_to((0.502, 0.0, -3.1), stamp=100.04)
    scene.now = 100.04
    scene.sees(stamp=100.01)
    _, _, state = scene.look(after=100.0)
    np.testing.assert_allclose(state_arrays(state)[0], (0.5005, 0.0, 3.1 + 0.25 * (2.0 * np.pi - 6.2)), atol=1e-9)


def test_a_fresh_image_that_comes_in_time_is_waited_for():
    scene = Scene(max_age=10.0)
    scene.step(HERE)
    scene.look()
    threading.Timer(0.05, scene.step, [THERE]).start()
    _, _, state = scene.look(after=scene.now + 0.4)
    assert state.x == THERE[0]


def test_a_camera_that_has_not_sent_anything_is_named(scene):
    scene.moves_to(HERE)
    check_refused(scene, "no image on /camera/image_raw yet")


def test_a_silent_camera_is_named(scene):
    scene.step(HERE)
    scene.look()
    scene.now += 0.5
    scene.moves_to(THERE)
    check_refused(scene, "no new image on /camera/image_raw within camera/max_age (0.05 s): the newest is 0.50 s old")


def test_a_camera_that_keeps_sending_one_stamp_is_called_frozen(scene):
    scene.step(HERE)
    scene.look()
    for _ in range(2):
        scene.now += 0.5
        scene.moves_to(HERE)
        scene.sees(stamp=100.5)
        check_refused(scene, "images on /camera/image_raw keep coming with one stamp, 100.500 s")


def test_a_stamp_is_handed_out_once_also_when_time_stands_still(scene):
    scene.step(HERE)
    scene.look()
    scene.sees()
    check_refused(scene, "one stamp")


def test_images_that_are_older_than_the_limit_are_refused(scene):
    scene.moves_to(HERE, stamp=100.0)
    scene.sees(stamp=100.0)
    scene.now = 101.5
    check_refused(scene, "come too late: the newest is 1.50 s old, camera/max_age is 0.05 s", after=100.0)


def test_images_that_always_come_late_are_refused(scene):
    scene.moves_to(HERE, stamp=100.0)
    scene.moves_to(HERE, stamp=101.0)
    scene.now = 101.0
    threading.Timer(0.01, scene.sees, [None, 100.2]).start()
    check_refused(scene, "come too late: the newest is 0.80 s old, camera/max_age is 0.05 s")


def test_images_from_the_future_are_refused(scene):
    scene.moves_to(HERE)
    scene.sees(stamp=scene.now + 2.0)
    scene.moves_to(HERE, stamp=scene.now + 2.0)
    check_refused(scene, "is stamped 2.00 s in the future")


def test_a_clock_whose_message_is_still_under_way_is_no_future(scene):
    scene.moves_to(HERE, stamp=100.5)
    scene.sees(stamp=100.5)
    stamp, _, _ = scene.look(after=100.5)
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
def test_an_image_that_is_not_what_the_model_takes_is_refused_and_the_next_one_is_not(scene, spoil, words):
    scene.moves_to(HERE)
    image = image_message(scene.time(None), scene.picture())
    spoil(image)
    scene.camera.add_image(image)
    check_refused(scene, words)
    scene.step(HERE)
    scene.look()


def test_a_picture_of_one_single_colour_is_refused(scene):
    scene.step(HERE, np.zeros((8, 8, 3), np.uint8))
    message = refusal(scene)
    assert "is of one single colour, [0, 0, 0]" in message
    assert "camera/allow_featureless" in message
    scene.step(HERE)
    scene.look()


def test_pictures_of_one_single_colour_are_taken_where_that_is_allowed():
    scene, plain = Scene(allow_featureless=True), np.full((8, 8, 3), 7, np.uint8)
    for pose in (HERE, THERE):
        scene.step(pose, plain)
        scene.look()
    picture = scene.step(HERE)
    scene.look()
    scene.step(THERE, picture)
    check_refused(scene, "is the same as from")


def test_the_same_picture_from_another_place_is_never_handed_out(scene):
    picture = scene.step(HERE)
    scene.look()
    scene.step(THERE, picture)
    check_refused(scene, "the image on /camera/image_raw is the same as from x 0.500 m, y 0.000 m, theta 0.00 rad")
    scene.step(THERE, picture)
    check_refused(scene, "is the same as from")
    for _ in range(3):
        scene.step(THERE, picture)
        message = refusal(scene)
        assert "have been byte-identical since the arm was at x 0.500 m, y 0.000 m, theta 0.00 rad" in message
        assert "the camera is frozen" in message
    scene.step(THERE)
    scene.look()
    scene.step(HERE, picture)
    scene.look()


@pytest.mark.parametrize(("pose", "moved"), [((0.5005, 0.0, 0.005), False), ((0.5015, 0, 0), True), (THERE, True)])
def test_a_camera_that_stands_still_may_see_the_same_to_the_last_bit(scene, pose, moved):
    picture = scene.step(HERE)
    scene.look()
    scene.step(pose, picture)
    if moved:
        check_refused(scene, "is the same as from")
    else:
        scene.look()


def test_a_slow_drift_is_measured_from_where_the_picture_was_first_seen(scene):
    picture = scene.step(HERE)
    for x in (0.5004, 0.5008):
        scene.step((x, 0.0, 0.0), picture)
        scene.look()
    scene.step((0.5012, 0.0, 0.0), picture)
    check_refused(scene, "is the same as from x 0.500 m")


def test_a_camera_that_froze_between_two_looks_is_found_out(scene):
    scene.step(HERE)
    scene.look()
    picture = scene.step((0.51, 0.0, 0.0))
    scene.step(THERE, picture)
    check_refused(scene, "is the same as from x 0.510 m")


@pytest.mark.parametrize("wrong", [{"stamp": 100.6}, {"stamp": 110.0}])
def test_a_picture_whose_first_stamps_were_wrong_is_counted_from_the_first_right_one(scene, wrong):
    scene.step(HERE)
    scene.look()
    scene.moves_to(HERE, stamp=100.6)
    scene.now = 101.0
    scene.moves_to(THERE)
    picture = scene.sees(**wrong)
    refusal(scene)
    scene.step(THERE, picture)
    scene.look()


def test_a_picture_that_came_with_an_old_stamp_is_counted_from_its_first_own_one(scene):
    scene.step(HERE)
    scene.look()
    near = (0.502, 0.0, 0.0)
    scene.now += 0.04
    scene.moves_to(near)
    picture = scene.sees(stamp=100.5)
    check_refused(scene, "one stamp")
    scene.now += 0.01
    scene.moves_to(near)
    scene.sees(picture)
    scene.look()


def test_a_picture_seen_while_the_pose_was_wrong_is_counted_from_the_first_right_one(scene):
    scene.step(HERE)
    scene.look()
    scene.now += 0.01
    scene.moves_to((0.6, 0.0, 0.0))
    picture = scene.sees()
    check_refused(scene, "jumped")
    for _ in range(2):
        scene.now += 0.01
        scene.moves_to(HERE)
        scene.sees(picture)
    check_refused(scene, "jumped")
    scene.look()


def test_a_picture_first_seen_before_any_state_is_counted_from_its_first_look(scene):
    picture = scene.sees()
    scene.step(HERE, picture)
    scene.look()
    scene.step(THERE, picture)
    check_refused(scene, "is the same as from x 0.500 m")


def test_an_arm_that_has_not_told_its_state_is_named(scene):
    scene.sees()
    check_refused(scene, "no state on /arm/state around the image's stamp: there is none yet")


def test_a_silent_pose_is_named(scene):
    scene.step(HERE)
    scene.look()
    scene.now += 0.5
    scene.sees()
    message = refusal(scene)
    assert "no state on /arm/state around the image's stamp: the newest is 0.50 s older than the image" in message
    assert "camera/max_age (0.05 s)" in message


def test_a_pose_that_keeps_one_stamp_is_named(scene):
    scene.step(HERE)
    scene.look()
    scene.moves_to(HERE)
    scene.now += 0.5
    scene.sees()
    check_refused(scene, "they keep coming with one stamp, 100.500 s")


def test_a_stamp_belongs_to_the_first_state_that_came_with_it(scene):
    scene.moves_to(HERE)
    scene.moves_to((0.504, 0.0, 0.0))
    scene.sees()
    assert scene.look()[2].x == HERE[0]


def test_states_with_a_gap_around_the_image_are_not_interpolated(scene):
    scene.moves_to(HERE, stamp=100.0)
    scene.moves_to(THERE, stamp=100.2)
    scene.now = 100.12
    scene.sees(stamp=100.1)
    check_refused(scene, "no state on /arm/state for 0.20 s around the image's stamp", after=100.05)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_pose_that_is_not_finite_is_refused_and_nothing_is_interpolated_across_it(scene, value):
    scene.moves_to(HERE, stamp=100.0)
    scene.moves_to((0.5, value, 0.0), stamp=100.01)
    scene.sees(stamp=100.01)
    check_refused(scene, "/arm/state holds values that are not finite")
    scene.moves_to(HERE, stamp=100.02)
    check_refused(scene, "the oldest is 0.01 s newer than the image")


def test_a_pose_that_jumps_is_held_for_once_and_its_new_track_is_gone_on_with(scene):
    scene.moves_to(HERE, stamp=100.00)
    scene.moves_to((0.6, 0.0, 0.0), stamp=100.02)
    scene.sees(stamp=100.01)
    message = refusal(scene)
    assert "the pose on /arm/state jumped by 0.100 m and 0.00 rad in 0.020 s, faster than the arm can move" in message
    check_refused(scene, "the oldest is 0.01 s newer than the image")
    scene.step((0.6, 0.0, 0.0))
    _, _, state = scene.look()
    assert state.x == 0.6


def test_a_turn_that_no_arm_can_make_is_a_jump_too(scene):
    scene.step(HERE)
    scene.step((0.5, 0.0, 2.9))
    check_refused(scene, "jumped by 0.000 m and 2.90 rad")


def test_an_arm_at_its_speed_limit_does_not_jump(scene):
    limits = Config().arm
    for step in range(20):
        scene.now += 0.01
        share = 0.01 * step
        scene.moves_to((0.4 + share * limits.max_speed, share * limits.max_speed, share * limits.max_turn_rate))
    scene.sees()
    scene.look()


def test_a_clock_that_goes_back_forgets_what_was_before(scene):
    picture = scene.step(HERE)
    scene.look()
    scene.now = 5.0
    check_refused(scene, "in the future", after=0.0)
    scene.moves_to((0.6, 0.1, 1.0))
    check_refused(scene, "in the future", after=0.0)
    scene.sees(picture)
    stamp, _, state = scene.look()
    assert (stamp.to_sec(), state.x) == (5.0, 0.6), "no jump, and no picture of before"


def test_nothing_is_interpolated_across_a_clock_that_goes_back(scene):
    scene.moves_to(HERE, stamp=100.0)
    scene.moves_to(HERE, stamp=99.98)
    scene.now = 99.99
    scene.sees()
    check_refused(scene, "the newest is 0.01 s older than the image")
