"""Conversion of sessions into bags and back is lossless."""

import numpy as np
import pytest
import rosbag
from hypothesis import given, settings
from hypothesis import strategies as st

from embodied_active_learning.config import Config, merge
from embodied_active_learning.errors import BagError, SessionError
from embodied_active_learning.ros.bags.conversion import read_session, write_session
from embodied_active_learning.ros.bags.recording import Recording
from embodied_active_learning.session.observations import ObservationStore
from embodied_active_learning.session.session import Session

VALUES = {
    "camera": {"width": 12, "height": 12},
    "training": {"updates_per_observation": 0},
    "arm": {"max_speed": 0.1},
}


def make_session(root, observations, name="made"):
    """Write a session from (stamp [s], state, image seed) of each observation."""
    config = Config.from_dict({**VALUES, "session": {"root": str(root), "name": name}})
    with Session.open_for_writing(config) as session:
        with session.open_observations() as store, session.open_table("exploration") as table:
            for index, (stamp, state, seed) in enumerate(observations):
                image = np.random.default_rng(seed).integers(0, 256, (12, 12, 3), dtype=np.uint8)
                store.append(index, stamp, state, image)
                place = dict(zip(("time", "x", "y", "theta"), (stamp, *state)))
                measures = {"coverage": seed / 7, "ergodic_measure": 1 / (seed + 3), "distance": 0.1 * index}
                table.append({"step": index + 1, **place, **measures, "turning": 0.0, "effort": float("nan")})
        return session.paths.path


def back(bag, root, name="back"):
    recording = Recording(bag)
    changes = {"session": {"root": str(root), "name": name}, "arm": {"robot": "recording"}}
    return read_session(recording, Config.from_dict(merge(recording.settings(), changes)))


def content(session, *parts):
    return session.joinpath(*parts).read_bytes()


instants = st.builds(lambda s, ns: s + ns / 1e9, st.integers(0, 2**31), st.integers(0, 10**9 - 1))
numbers = st.floats(-1e3, 1e3, allow_nan=False)
stored = st.lists(st.tuples(instants, st.tuples(numbers, numbers, numbers), st.integers(0, 99)), min_size=1, max_size=4)


@settings(max_examples=25)
@given(observations=stored, compression=st.sampled_from(["none", "bz2", "lz4"]))
def test_round_trip_is_bit_exact(tmp_path_factory, observations, compression):
    root = tmp_path_factory.mktemp("round")
    made = make_session(root, observations)
    assert write_session(made, root / "a.bag", compression) == len(observations)
    again = back(root / "a.bag", root)
    for file in (("observations", "observations.bin"), ("exploration.csv",)):
        assert content(again, *file) == content(made, *file)
    assert Session.open_read_only(again).config.arm.max_speed == 0.1


SAMPLE = [(0.2 * (n + 1), (0.4 + 0.01 * n, 0.0, 0.1), n) for n in range(5)]


def test_bag_of_session_is_readable_by_rosbag(tmp_path):
    write_session(make_session(tmp_path, SAMPLE), tmp_path / "a.bag")
    with rosbag.Bag(str(tmp_path / "a.bag")) as bag:
        counts = {topic: info.message_count for topic, info in bag.get_type_and_topic_info().topics.items()}
        times = [time.to_sec() for _, _, time in bag.read_messages("/camera/image_raw")]
    each = ("/observation", "/camera/image_raw", "/arm/state", "/target_distribution")
    assert counts == {"/run_config": 1, **dict.fromkeys(each, 5)}
    assert times == pytest.approx([stamp for stamp, _, _ in SAMPLE])
    assert bytes(tmp_path) not in (tmp_path / "a.bag").read_bytes(), "the bag contains the path of the session"


def test_existing_files_are_not_replaced(tmp_path):
    made = make_session(tmp_path, SAMPLE)
    write_session(made, tmp_path / "a.bag")
    before = (tmp_path / "a.bag").read_bytes()
    with pytest.raises(BagError, match="exists: choose another name"):
        write_session(made, tmp_path / "a.bag")
    with pytest.raises(BagError, match=r"invalid bag name .* must end in .bag"):
        write_session(made, tmp_path / "a.yaml")
    with pytest.raises(SessionError, match="made exists: choose another"):
        back(tmp_path / "a.bag", tmp_path, "made")
    with pytest.raises(SessionError, match="give 1 to 64 of a-z"):
        back(tmp_path / "a.bag", tmp_path, "../made")
    assert (tmp_path / "a.bag").read_bytes() == before


def test_incomplete_session_is_removed(tmp_path, monkeypatch):
    write_session(make_session(tmp_path, SAMPLE), tmp_path / "a.bag")

    def fail(*_):
        raise SessionError("the disk is full")

    monkeypatch.setattr(ObservationStore, "append", fail)
    with pytest.raises(SessionError, match="the disk is full"):
        back(tmp_path / "a.bag", tmp_path)
    assert not (tmp_path / "back").exists()


def test_stamp_out_of_range_is_rejected(tmp_path):
    made = make_session(tmp_path, [(-1.0, (0.4, 0.0, 0.0), 1)])
    with pytest.raises(BagError, match=r"cannot write the stamp -1.0 s into a bag"):
        write_session(made, tmp_path / "a.bag")
    assert [path.name for path in tmp_path.iterdir()] == ["made"]
