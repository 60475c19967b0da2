"""A session's observations as a bag, and a bag's as a session; what goes there comes back to the last bit."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Dict, List

from std_msgs.msg import Header, String

from embodied_active_learning.config import Config
from embodied_active_learning.errors import BagError
from embodied_active_learning.msg import Observation, TargetDistribution
from embodied_active_learning.ros import names
from embodied_active_learning.ros.bags.recording import Recording, recorded_stamp, settings_text
from embodied_active_learning.ros.bags.writer import BagWriter
from embodied_active_learning.ros.conversions import image_array, image_message, state_arrays, state_message
from embodied_active_learning.session.session import Session

MEASURES = ("ergodic_measure", "coverage", "distance", "turning", "effort")
"""Columns of exploration.csv that go into a bag as target distributions, whose samples a session does not keep."""


def write_session(session_path: Path, bag_path: Path, compression: str = "none") -> int:
    """Write a session's observations, images, states and measures into a new bag -> how many observations.

    Stamps are kept to the nanosecond; velocities are not stored in a session, and are 0. compression: none, bz2 or lz4.
    Raises SessionError for a session that cannot be read, BagError for a bag that cannot be written; nothing is left
    of it then.
    """
    bag_path = Path(bag_path)
    if bag_path.suffix != ".bag":
        raise BagError(f"{bag_path} is no name for a bag: let it end with .bag")
    session = Session.open_read_only(session_path)
    rows = session.read_table("exploration")
    steps = {int(step): row for row, step in enumerate(rows["step"])}
    with session.open_observations() as store, BagWriter(bag_path, compression) as bag:
        for index in range(len(store)):
            stamp = recorded_stamp(float(store.stamps[index]))
            state = state_message(stamp, store.raw_states[index], (0.0, 0.0, 0.0))
            image = image_message(stamp, store.images[index])
            if not index:
                bag.write(f"/{names.RUN_CONFIG}", String(settings_text(session.config)), stamp, latched=True)
            bag.write(f"/{names.ARM_STATE}", state, stamp)
            bag.write(f"/{names.CAMERA_IMAGE}", image, stamp)
            bag.write(f"/{names.OBSERVATION}", Observation(Header(stamp=stamp), index, state, image), stamp)
            if index + 1 in steps:
                measures = {name: float(rows[name][steps[index + 1]]) for name in MEASURES}
                message = TargetDistribution(header=state.header, step=index + 1, **measures)
                bag.write(f"/{names.TARGET_DISTRIBUTION}", message, stamp)
        return len(store)


def read_session(recording: Recording, config: Config) -> Path:
    """Store a recording's observations, and its measures where none was lost, in a new session -> its folder.

    Raises SessionError when there is one of the name, and as Recording.observations does; nothing is left of it then.
    """
    with Session.open_for_writing(config) as session:
        try:
            _fill(session, recording)
        except BaseException:
            shutil.rmtree(session.paths.path, ignore_errors=True)
            raise
        return session.paths.path


def _fill(session: Session, recording: Recording) -> None:
    camera = session.config.camera
    places: List[Dict[str, float]] = []
    with session.open_observations() as store:
        for observation in recording.observations(session.config):
            if len(store) == session.config.exploration.steps:
                break
            state, stamp = state_arrays(observation.state)[0], observation.header.stamp.to_sec()
            store.append(observation.index, stamp, state, image_array(observation.image, camera.height, camera.width))
            places.append({"time": stamp, **dict(zip(("x", "y", "theta"), state.tolist()))})
    if recording.lost or not recording.has_observations:
        return
    with session.open_table("exploration") as table:
        for message in recording.measures():
            if message.step <= len(places):
                measures = {name: getattr(message, name) for name in MEASURES}
                table.append({"step": message.step, **places[message.step - 1], **measures})
