"""What a recording holds for learning: its observations, or what images and arm states make of them."""

from pathlib import Path

import numpy as np
import pytest
import rosbag
import rospy
from embodied_active_learning.msg import Observation
from std_msgs.msg import Header, String

from embodied_active_learning.config import Config
from embodied_active_learning.errors import BagError, ConfigError, ObservationError
from embodied_active_learning.pipeline.resolve import resolve
from embodied_active_learning.ros.bags.pairing import is_due
from embodied_active_learning.ros.bags.recording import Recording, read_settings, settings_text
from embodied_active_learning.ros.bags.replay_config import resolve_copy, resolve_replay
from embodied_active_learning.ros.bags.writer import BagWriter
from embodied_active_learning.ros.conversions import image_message, state_arrays, state_message
from embodied_active_learning.session.session import Session

CONFIG = Config.from_dict({"camera": {"width": 8, "height": 8}, "training": {"learning_rate": 0.002}})
STILL = (0.0, 0.0, 0.0)


def picture(seed, size=8):
    return np.random.default_rng(seed).integers(0, 256, (size, size, 3), dtype=np.uint8)


def observation(index, size=8):
    stamp = rospy.Time(10 + index)
    state = state_message(stamp, (0.4 + 0.01 * index, 0.0, 0.0), STILL)
    return Observation(Header(stamp=stamp), index, state, image_message(stamp, picture(index, size)))


def record(path, indices, namespace="", size=8):
    with BagWriter(path) as bag:
        for index in indices:
            bag.write(f"{namespace}/observation", observation(index, size), rospy.Time(index))
    return path


def indices_of(recording, config=CONFIG):
    """The recorded numbers, told by the stamps."""
    found = list(recording.observations(config))
    assert [item.index for item in found] == list(range(len(found)))
    return [item.header.stamp.secs - 10 for item in found]


def test_the_bags_of_a_run_that_was_resumed_are_one_recording(tmp_path):
    record(tmp_path / "20260101.bag", range(5))
    record(tmp_path / "20260102.bag", range(4, 8))  # the last one was told again
    recording = Recording(tmp_path)
    assert indices_of(recording) == list(range(8))
    assert recording.lost == 0


def test_observations_that_were_not_recorded_are_counted_and_leave_no_gap(tmp_path):
    recording = Recording(record(tmp_path / "a.bag", [1, 2, 5]))
    assert indices_of(recording) == [1, 2, 5]
    assert recording.lost == 3


def test_of_several_systems_in_a_bag_one_has_to_be_named(tmp_path):
    record(tmp_path / "a.bag", range(3), "/left")
    assert indices_of(Recording(tmp_path)) == [0, 1, 2]
    record(tmp_path / "b.bag", range(5), "/right")
    with pytest.raises(BagError, match="holds several systems, /left, /right: say which one by namespace:="):
        Recording(tmp_path)
    assert len(indices_of(Recording(tmp_path, "right"))) == 5


def test_pictures_of_another_size_are_cropped_and_scaled(tmp_path):
    recording = Recording(record(tmp_path / "a.bag", range(2), size=24))
    found = [np.frombuffer(item.image.data, np.uint8).reshape(8, 8, 3) for item in recording.observations(CONFIG)]
    expected = picture(0, 24).reshape(8, 3, 8, 3, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(found[0], expected, atol=1.0)


def test_a_recording_knows_the_settings_of_its_run_and_a_profile_replaces_them(tmp_path):
    with BagWriter(tmp_path / "a.bag") as bag:
        bag.write("/run_config", String(settings_text(CONFIG)), rospy.Time(1))
        for index in range(70):
            bag.write("/observation", observation(index), rospy.Time(index))
    recording, target = Recording(tmp_path / "a.bag"), [f"session/root={tmp_path}", "session/name=again"]
    config = resolve_replay(recording, "", target)
    assert (config.arm.robot, config.exploration.steps, config.training.learning_rate) == ("recording", 70, 0.002)
    assert config.camera.width == 8
    assert resolve_replay(recording, "paper", [*target, "exploration/steps=66"]).training.learning_rate == 0.001
    with pytest.raises(BagError, match="holds 70 observations, 71 steps were asked for"):
        resolve_replay(recording, "", [*target, "exploration/steps=71"])


def test_a_replay_that_is_resumed_makes_the_steps_that_it_was_to_make(tmp_path):
    recording = Recording(record(tmp_path / "a.bag", range(80)))
    profile = tmp_path / "small.yaml"
    profile.write_text("camera: {width: 8, height: 8}\nexploration: {steps: 1000}\n")
    target = [f"session/root={tmp_path}", "session/name=again"]
    Session.open_for_writing(resolve_replay(recording, str(profile), [*target, "exploration/steps=70"])).close()
    for given in ("", str(profile)):
        assert resolve_replay(recording, given, [*target, "session/resume=true"]).exploration.steps == 70
    more = resolve_replay(recording, "", [*target, "session/resume=true", "exploration/steps=75"])
    assert more.exploration.steps == 75


def test_too_few_observations_to_learn_from_can_be_stored_all_the_same(tmp_path):
    recording, target = (
        Recording(record(tmp_path / "a.bag", range(5))),
        [f"session/root={tmp_path}", "session/name=few"],
    )
    with pytest.raises(ConfigError, match=r"exploration/steps is 5, fewer than training/first_update_at \(64\)"):
        resolve_replay(recording, "", target)
    assert resolve_copy(recording, "", target).arm.robot == "recording"


@pytest.mark.parametrize(
    "text",
    ["camera: {widht: 8}", "!!python/object/apply:os.getcwd []", "[", "a: 1\n" * 10**5],
    ids=["mistyped", "code", "unfinished", "endless"],
)
def test_recorded_settings_that_are_none_are_refused(tmp_path, text):
    with BagWriter(tmp_path / "a.bag") as bag:
        bag.write("/run_config", String(text), rospy.Time(1))
        bag.write("/observation", observation(0), rospy.Time(1))
    with pytest.raises(ConfigError, match=r"a.bag: the recorded settings cannot be used \("):
        Recording(tmp_path / "a.bag").settings()


def test_a_bag_without_anything_to_learn_from_is_refused_with_what_it_holds(tmp_path):
    with BagWriter(tmp_path / "a.bag") as bag:
        bag.write("/camera/image_raw", image_message(rospy.Time(1), picture(0)), rospy.Time(1))
    expected = "holds neither /observation nor both /camera/image_raw and /arm/state: .* there are /camera/image_raw"
    with pytest.raises(BagError, match=expected):
        Recording(tmp_path / "a.bag")
    (tmp_path / "a.bag").unlink()
    with pytest.raises(BagError, match="holds no bag"):
        Recording(tmp_path)


def test_a_message_of_another_version_is_refused_by_its_checksum(tmp_path):
    with rosbag.Bag(str(tmp_path / "a.bag"), "w") as bag:
        bag.write("/observation", String("import os"))
    with pytest.raises(BagError, match=r"/observation is 'std_msgs/String' of another version than"):
        Recording(tmp_path / "a.bag").count(CONFIG)


def record_motion(path, seconds, pose=lambda time: (0.4 + 0.05 * time, 0.0, 0.0), image=None, size=8):
    """States at 100 Hz and images at 30 Hz, as from a real arm."""
    events = [(0.01 * n, "state") for n in range(int(100 * seconds))]
    events += [(0.003 + n / 30.0, "image") for n in range(int(30 * seconds))]
    with BagWriter(path) as bag:
        for number, (time, kind) in enumerate(sorted(events)):
            stamp = rospy.Time.from_sec(100.0 + time)
            if kind == "state":
                bag.write("/arm/state", state_message(stamp, pose(time), STILL), stamp)
            else:
                shown = picture(number, size) if image is None else image
                bag.write("/camera/image_raw", image_message(stamp, shown), stamp)
    return Recording(path)


@pytest.mark.parametrize("size", [8, 24])
def test_images_and_states_make_one_observation_a_step_with_the_pose_at_the_images_stamp(tmp_path, size):
    found = list(record_motion(tmp_path / "a.bag", 3.0, size=size).observations(CONFIG))
    stamps = np.array([item.header.stamp.to_sec() for item in found])
    assert len(found) == 15
    assert np.diff(stamps).min() >= 0.199
    assert np.diff(stamps).max() < 0.24
    states = np.array([state_arrays(item.state)[0] for item in found])
    np.testing.assert_allclose(states[:, 0], 0.4 + 0.05 * (stamps - 100.0), atol=1e-6)
    assert all((item.image.width, item.image.height) == (8, 8) for item in found)
    assert all(item.image.header.stamp == item.state.header.stamp for item in found)


@pytest.mark.parametrize(
    ("now", "last", "due"),
    [(1.0, None, True), (1.1, 1.0, True), (1.09, 1.0, False), (1.0, 1.0, False), (0.5, 1.0, True)],
)
def test_an_image_is_taken_when_a_period_has_passed_or_time_has_gone_back(now, last, due):
    assert is_due(rospy.Time(now), None if last is None else rospy.Time(last), 0.1) == due


def test_images_while_the_arm_stands_still_or_is_elsewhere_are_no_observations(tmp_path):
    stands = record_motion(tmp_path / "a.bag", 2.0, pose=lambda time: (0.4 + 0.05 * min(time, 1.0), 0.0, 0.0))
    assert stands.count(CONFIG) == 6
    outside = record_motion(tmp_path / "b.bag", 2.0, pose=lambda time: (0.2 + 0.15 * time, 0.0, 0.0))
    states = [state_arrays(item.state)[0] for item in outside.observations(CONFIG)]
    assert 4 < len(states) < 8
    assert CONFIG.workspace.box().contains(np.array(states), 0.05).all()


def test_images_that_no_planner_would_take_are_refused_with_the_reason(tmp_path):
    blind = record_motion(tmp_path / "a.bag", 1.0, image=np.full((8, 8, 3), 9, np.uint8))
    with pytest.raises(ObservationError, match=r"no image goes with a state of the arm: .*one single colour"):
        blind.count(CONFIG)
    frozen = record_motion(tmp_path / "b.bag", 1.0, image=picture(0))
    assert frozen.count(CONFIG) == 1
    assert "the same as from" in frozen.refused


def test_a_bag_is_never_written_over_another_one_and_nothing_is_left_of_one_that_failed(tmp_path):
    record(tmp_path / "a.bag", range(2))
    with pytest.raises(BagError, match="exists: choose another name"):
        record(tmp_path / "a.bag", range(3))
    with pytest.raises(RuntimeError), BagWriter(tmp_path / "b.bag"):
        raise RuntimeError
    assert [path.name for path in tmp_path.iterdir()] == ["a.bag"]


def test_until_it_is_closed_a_bag_has_another_name(tmp_path):
    bag = BagWriter(tmp_path / "a.bag")
    bag.write("/observation", observation(0), rospy.Time(1))
    assert [path.name for path in tmp_path.iterdir()] == ["a.bag.active"]
    assert bag.size > 0
    bag.close()
    bag.close()
    bag.write("/observation", observation(1), rospy.Time(1))
    assert indices_of(Recording(tmp_path)) == [0]


def test_the_bag_that_comes_with_the_package_is_of_the_profile_beside_it(tmp_path):
    bags = Path(__file__).resolve().parents[3] / "bags"
    recording = Recording(bags / "diagonal-small.bag")
    made = resolve(str(bags / "diagonal-small.yaml"), [f"session/root={tmp_path}"])
    assert recording.settings() == read_settings(settings_text(made))
    assert recording.count(made) == made.exploration.steps == 400
