"""Recording: observations of a recorded run, or pairs of images and arm states."""

import runpy
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import rosbag
import rospy
from embodied_active_learning.msg import Observation, TargetDistribution
from hypothesis import given
from hypothesis import strategies as st
from std_msgs.msg import Header, String

from embodied_active_learning.config import CONFIG_VERSION, Config
from embodied_active_learning.errors import (
    BagError,
    ConfigError,
    EmbodiedActiveLearningError,
    ObservationError,
    SessionError,
)
from embodied_active_learning.pipeline.resolve import resolve_config
from embodied_active_learning.ros.bags import pairing, session_bag
from embodied_active_learning.ros.bags.pairing import RecordedPairs, is_due
from embodied_active_learning.ros.bags.recording import Recording
from embodied_active_learning.ros.bags.replay_config import resolve_copy, resolve_replay
from embodied_active_learning.ros.bags.run_settings import read_settings, settings_text
from embodied_active_learning.ros.bags.session_bag import SessionBag
from embodied_active_learning.ros.bags.writer import BagWriter
from embodied_active_learning.ros.conversions import image_message, state_arrays, state_message
from embodied_active_learning.session.session import Session
from launching import ROOT

CONFIG = Config.from_dict({"camera": {"width": 8, "height": 8}, "training": {"learning_rate": 0.002}})
STILL = (0.0, 0.0, 0.0)


def picture(seed, size=8):
    return np.random.default_rng(seed).integers(0, 256, (size, size, 3), dtype=np.uint8)


def observation(index, size=8, start=10):
    stamp = rospy.Time(start + index)
    state = state_message(stamp, (0.4 + 0.01 * index, 0.0, 0.0), STILL)
    return Observation(Header(stamp=stamp), index, state, image_message(stamp, picture(index, size)))


def record(path, indices, namespace="", size=8, start=10):
    with BagWriter(path) as bag:
        for index in indices:
            bag.write(f"{namespace}/observation", observation(index, size, start), rospy.Time(index))
    return path


def indices_of(recording, config=CONFIG):
    """Return the recorded indices, derived from the stamps."""
    found = list(recording.observations(config))
    assert [item.index for item in found] == list(range(len(found)))
    return [item.header.stamp.secs - 10 for item in found]


def test_bags_of_resumed_run_are_joined(tmp_path):
    record(tmp_path / "20260101.bag", range(5))
    record(tmp_path / "20260102.bag", range(4, 8))  # the last one was published again
    recording = Recording(tmp_path)
    assert indices_of(recording) == list(range(8))
    assert recording.lost == 0


def test_split_bags_are_ordered_by_stamp(tmp_path):
    """`rosbag record --split` numbers without padding: run_10 sorts before run_2 by name."""
    for part in range(12):
        record(tmp_path / f"run_{part}.bag", range(3 * part, 3 * part + 3))
    recording = Recording(tmp_path)
    assert indices_of(recording) == list(range(36))
    assert recording.warnings() == []


def test_bag_order_ignores_names(tmp_path):
    record(tmp_path / "z.bag", range(3))
    record(tmp_path / "a.bag", range(3, 6))
    assert indices_of(Recording(tmp_path)) == list(range(6))


def test_second_run_is_left_out_and_reported(tmp_path):
    """Two runs in one bag: the second is longer, so that its numbers continue those of the first."""
    with BagWriter(tmp_path / "a.bag") as bag:
        for start, count in ((10, 5), (1000, 9)):
            for index in range(count):
                bag.write("/observation", observation(index, start=start), rospy.Time(start + index))
    recording = Recording(tmp_path / "a.bag")
    assert indices_of(recording) == list(range(5))
    (warning,) = recording.warnings()
    assert "holds more than one run" in warning
    assert "9 observations of others are left out" in warning


def test_second_simulated_run_with_same_stamps_is_detected(tmp_path):
    """Simulated runs all begin at the same time: only the content differs."""
    with BagWriter(tmp_path / "a.bag") as bag:
        for seed in (0, 100):
            for index in range(5):
                item = observation(index)
                item.image = image_message(item.header.stamp, picture(index + seed))
                bag.write("/observation", item, rospy.Time(1))
    recording = Recording(tmp_path / "a.bag")
    assert recording.count(CONFIG) == 5
    assert "5 observations of others are left out" in recording.warnings()[0]


def test_copied_bag_adds_nothing(tmp_path):
    """`rosbag reindex` leaves a copy of the original next to the bag."""
    for name in ("a.bag", "a.orig.bag"):
        record(tmp_path / name, range(5))
    recording = Recording(tmp_path)
    assert indices_of(recording) == list(range(5))
    assert recording.warnings() == []


def test_observations_made_again_are_used_once(tmp_path):
    """After a power failure a resumed run makes its last observations again, with new stamps and images."""
    record(tmp_path / "a.bag", range(6))
    record(tmp_path / "b.bag", range(5, 8), start=50)
    recording = Recording(tmp_path)
    assert [item.header.stamp.secs for item in recording.observations(CONFIG)] == [*range(10, 16), 56, 57]
    assert "1 observations were recorded twice" in recording.warnings()[0]


def test_lost_observations_are_counted(tmp_path):
    recording = Recording(record(tmp_path / "a.bag", [1, 2, 5]))
    assert indices_of(recording) == [1, 2, 5]
    assert recording.lost == 3
    assert recording.warnings() == ["3 observations of the run were not recorded: the others are used"]


def test_several_systems_require_a_namespace(tmp_path):
    record(tmp_path / "a.bag", range(3), "/left")
    assert indices_of(Recording(tmp_path)) == [0, 1, 2]
    record(tmp_path / "b.bag", range(5), "/right")
    with pytest.raises(BagError, match="has several systems, /left, /right: select one with namespace:="):
        Recording(tmp_path)
    assert len(indices_of(Recording(tmp_path, "right"))) == 5


def test_images_are_cropped_and_scaled(tmp_path):
    recording = Recording(record(tmp_path / "a.bag", range(2), size=24))
    found = [np.frombuffer(item.image.data, np.uint8).reshape(8, 8, 3) for item in recording.observations(CONFIG)]
    expected = picture(0, 24).reshape(8, 3, 8, 3, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(found[0], expected, atol=1.0)


def test_profile_overrides_recorded_settings(tmp_path):
    with BagWriter(tmp_path / "a.bag") as bag:
        bag.write("/run_config", String(settings_text(CONFIG)), rospy.Time(1))
        for index in range(70):
            bag.write("/observation", observation(index), rospy.Time(index))
    recording, target = Recording(tmp_path / "a.bag"), [f"session/root={tmp_path}", "session/name=again"]
    config = resolve_replay(recording, "", target)
    assert (config.arm.robot, config.exploration.steps, config.training.learning_rate) == ("recording", 70, 0.002)
    assert config.camera.width == 8
    assert resolve_replay(recording, "default", [*target, "exploration/steps=66"]).training.learning_rate == 0.001
    with pytest.raises(BagError, match="has 70 observations, 71 steps were requested"):
        resolve_replay(recording, "", [*target, "exploration/steps=71"])


@pytest.mark.parametrize(("updates", "warned"), [(0, True), (1, False)])
def test_replay_without_learning_is_warned_about(tmp_path, monkeypatch, capsys, updates, warned):
    monkeypatch.setenv("ROS_MASTER_URI", "http://localhost:1")
    profile = tmp_path / "small.yaml"
    profile.write_text(f"camera: {{width: 8, height: 8}}\ntraining: {{updates_per_observation: {updates}}}\n")
    main = runpy.run_path(str(ROOT / "scripts" / "resolve_replay"))["main"]
    bag = record(tmp_path / "a.bag", range(70))
    assert main([str(bag), "--profile", str(profile), "--set", f"session/root={tmp_path}"]) == 0
    captured = capsys.readouterr()
    assert f"updates_per_observation: {updates}" in captured.out
    assert ("warning: nothing will be learned" in captured.err) == warned


def test_resumed_replay_keeps_its_number_of_steps(tmp_path):
    recording = Recording(record(tmp_path / "a.bag", range(80)))
    profile = tmp_path / "small.yaml"
    profile.write_text("camera: {width: 8, height: 8}\nexploration: {steps: 1000}\n")
    target = [f"session/root={tmp_path}", "session/name=again"]
    Session.open_for_writing(resolve_replay(recording, str(profile), [*target, "exploration/steps=70"])).close()
    for chosen in ("", str(profile)):
        assert resolve_replay(recording, chosen, [*target, "session/resume=true"]).exploration.steps == 70
    more = resolve_replay(recording, "", [*target, "session/resume=true", "exploration/steps=75"])
    assert more.exploration.steps == 75


def test_few_observations_can_be_stored_as_session(tmp_path):
    recording, target = (
        Recording(record(tmp_path / "a.bag", range(5))),
        [f"session/root={tmp_path}", "session/name=few"],
    )
    with pytest.raises(ConfigError, match=r"exploration/steps is 5, fewer than training/first_update_at \(64\)"):
        resolve_replay(recording, "", target)
    assert resolve_copy(recording, "", target).arm.robot == "recording"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"{{version: {CONFIG_VERSION}, camera: {{widht: 8}}}}", "unknown key camera/widht"),
        ("version: 5", f"version is 5, but this package reads version {CONFIG_VERSION} only"),
        ("camera: {width: 8}", "version is None, but"),
        ("[]", "version is None, but"),
        ("!!python/object/apply:os.getcwd []", "tag"),
        ("[", "line 1"),
        ("a: 1\n" * 10**5, "characters"),
    ],
    ids=["mistyped", "older", "unversioned", "list", "code", "unfinished", "endless"],
)
def test_invalid_recorded_settings_are_rejected(tmp_path, text, message):
    with BagWriter(tmp_path / "a.bag") as bag:
        bag.write("/run_config", String(text), rospy.Time(1))
        bag.write("/observation", observation(0), rospy.Time(1))
    with pytest.raises(ConfigError, match=rf"a.bag: invalid recorded settings: .*{message}.*; replay"):
        Recording(tmp_path / "a.bag").settings()


def test_bag_without_observations_is_rejected(tmp_path):
    with BagWriter(tmp_path / "a.bag") as bag:
        bag.write("/camera/image_raw", image_message(rospy.Time(1), picture(0)), rospy.Time(1))
    expected = "has no topic /observation, nor both /camera/image_raw and /arm/state: .* found: /camera/image_raw"
    with pytest.raises(BagError, match=expected):
        Recording(tmp_path / "a.bag")
    (tmp_path / "a.bag").unlink()
    with pytest.raises(BagError, match="no bag in"):
        Recording(tmp_path)


def test_message_with_other_md5_sum_is_rejected(tmp_path):
    with rosbag.Bag(str(tmp_path / "a.bag"), "w") as bag:
        bag.write("/observation", String("import os"))
    with pytest.raises(BagError, match=r"/observation has type 'std_msgs/String' with another MD5 sum than"):
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


def test_unstamped_images_are_reported(tmp_path):
    with BagWriter(tmp_path / "a.bag") as bag:
        for number in range(20):
            stamp = rospy.Time(100 + number)
            bag.write("/arm/state", state_message(stamp, (0.4 + 0.01 * number, 0.0, 0.0), STILL), stamp)
            bag.write("/camera/image_raw", image_message(rospy.Time(), picture(number)), stamp)
    with pytest.raises(ObservationError, match=r"the images have no time stamp \(header.stamp is 0\)"):
        Recording(tmp_path / "a.bag").count(CONFIG)


def test_repeated_images_are_paired_once(tmp_path):
    """A folder with two copies of a bag of images and states."""
    once = record_motion(tmp_path / "a.bag", 3.0).count(CONFIG)
    (tmp_path / "copy.bag").write_bytes((tmp_path / "a.bag").read_bytes())
    with pytest.raises(BagError, match=r"a.bag overlaps in time with another bag"):
        Recording(tmp_path).count(CONFIG)
    pairs = RecordedPairs(CONFIG)
    found = []
    for _ in range(2):
        for name, message in Recording(tmp_path / "a.bag")._messages(("camera/image_raw", "arm/state")):
            found += pairs.add_image(message) if name == "camera/image_raw" else pairs.add_state(message)
    assert len(found) == once


@pytest.mark.parametrize("size", [8, 24])
def test_images_are_paired_with_interpolated_states(tmp_path, size):
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
def test_image_is_due_after_period_or_clock_reset(now, last, due):
    assert is_due(rospy.Time(now), None if last is None else rospy.Time(last), 0.1) == due


def test_images_at_rest_or_outside_workspace_are_skipped(tmp_path):
    stands = record_motion(tmp_path / "a.bag", 2.0, pose=lambda time: (0.4 + 0.05 * min(time, 1.0), 0.0, 0.0))
    assert stands.count(CONFIG) == 6
    outside = record_motion(tmp_path / "b.bag", 2.0, pose=lambda time: (0.2 + 0.15 * time, 0.0, 0.0))
    states = [state_arrays(item.state)[0] for item in outside.observations(CONFIG)]
    assert 4 < len(states) < 8
    assert CONFIG.workspace.box().contains(np.array(states), 0.05).all()


def test_rejected_images_are_reported_with_reason(tmp_path):
    blind = record_motion(tmp_path / "a.bag", 1.0, image=np.full((8, 8, 3), 9, np.uint8))
    with pytest.raises(ObservationError, match=r"no image matches an arm state: .*single colour"):
        blind.count(CONFIG)
    frozen = record_motion(tmp_path / "b.bag", 1.0, image=picture(0))
    assert frozen.count(CONFIG) == 1
    assert "the same as from" in frozen.rejected
    assert any("recorded images were rejected" in warning for warning in frozen.warnings())


def test_writer_keeps_existing_bag_and_removes_failed_one(tmp_path):
    record(tmp_path / "a.bag", range(2))
    with pytest.raises(BagError, match="exists: choose another name"):
        record(tmp_path / "a.bag", range(3))
    with pytest.raises(RuntimeError), BagWriter(tmp_path / "b.bag"):
        raise RuntimeError
    assert [path.name for path in tmp_path.iterdir()] == ["a.bag"]


def test_session_bag_stops_when_disk_is_full(tmp_path, monkeypatch):
    """What was recorded is kept, later messages are dropped, and the run is not disturbed."""
    monkeypatch.setattr(rospy.Time, "now", lambda: rospy.Time(5))
    bag = SessionBag(CONFIG, tmp_path)
    bag.write("observation", observation(0))

    def fail(*_):
        raise SessionError("too little space")

    monkeypatch.setattr(session_bag, "check_space", fail)
    bag.check_disk()
    bag.check_disk()
    assert bag.stopped == "too little space"
    bag.write("observation", observation(1))
    bag.close()
    assert indices_of(Recording(tmp_path / "bags")) == [0]
    assert bag.values()["messages"] == 1


def test_bag_has_temporary_name_until_closed(tmp_path):
    bag = BagWriter(tmp_path / "a.bag")
    bag.write("/observation", observation(0), rospy.Time(1))
    assert [path.name for path in tmp_path.iterdir()] == ["a.bag.active"]
    assert bag.size > 0
    bag.close()
    bag.close()
    bag.write("/observation", observation(1), rospy.Time(1))
    assert indices_of(Recording(tmp_path)) == [0]


@pytest.fixture(scope="module")
def valid(tmp_path_factory):
    """Content of a bag with settings, observations, images, states and measures."""
    path = tmp_path_factory.mktemp("valid") / "a.bag"
    with BagWriter(path) as bag:
        bag.write("/run_config", String(settings_text(CONFIG)), rospy.Time(1))
        for index in range(4):
            item = observation(index)
            bag.write("/observation", item, rospy.Time(index + 1))
            bag.write("/camera/image_raw", item.image, rospy.Time(index + 1))
            bag.write("/arm/state", item.state, rospy.Time(index + 1))
            bag.write(
                "/target_distribution", TargetDistribution(header=item.header, step=index + 1), rospy.Time(index + 1)
            )
    return path.read_bytes()


@given(data=st.data())
def test_mutated_recording_is_read_or_rejected(valid, tmp_path_factory, data):
    """Bytes of settings, messages and records change; also topics, so that pairs are made instead of observations."""
    content = bytearray(valid)
    if data.draw(st.booleans()):
        content = bytearray(valid.replace(b"/observation", b"/observatxon"))
    for _ in range(data.draw(st.integers(0, 6))):
        content[data.draw(st.integers(13, len(content) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.getbasetemp() / "mutated.bag"
    path.write_bytes(content)
    with suppress(EmbodiedActiveLearningError):
        recording = Recording(path)
        recording.settings()
        assert recording.count(CONFIG) <= 4
        assert len(list(recording.measures())) <= 4
        recording.warnings()


def test_waiting_images_are_bounded(monkeypatch):
    """Without arm states, images are held back; the oldest are dropped beyond a number of bytes."""
    monkeypatch.setattr(pairing, "MAX_WAITING", 5 * 8 * 8 * 3)
    pairs = RecordedPairs(CONFIG)
    for number in range(20):
        assert list(pairs.add_image(image_message(rospy.Time(100 + number), picture(number)))) == []
    assert len(pairs._waiting) == 5


def test_shipped_bag_matches_its_profile(tmp_path):
    bags = Path(__file__).resolve().parents[3] / "bags"
    recording = Recording(bags / "diagonal-small.bag")
    made = resolve_config(str(bags / "diagonal-small.yaml"), {"session": {"root": str(tmp_path)}})
    recorded, expected = recording.settings(), read_settings(settings_text(made))
    for section in ("franka", "fingerprint", "identification"):  # not used by the recorded run
        assert recorded.pop(section)
        assert expected.pop(section)
    assert recorded == expected
    assert recording.count(made) == made.exploration.steps == 400
