"""Convert a session's observations into a bag and back without loss."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Dict, List

import rospy
from std_msgs.msg import Header, String

from embodied_active_learning.config import Config
from embodied_active_learning.errors import BagError
from embodied_active_learning.msg import Observation, TargetDistribution
from embodied_active_learning.ros import names
from embodied_active_learning.ros.bags.recording import Recording
from embodied_active_learning.ros.bags.run_settings import settings_text
from embodied_active_learning.ros.bags.writer import BagWriter
from embodied_active_learning.ros.conversions import image_array, image_message, state_arrays, state_message
from embodied_active_learning.session.session import Session
from embodied_active_learning.workspace import STATE_NAMES

STEP_COLUMNS = ("ergodic_measure", "coverage", "distance", "turning", "effort")
"""Columns of exploration.csv stored as target distributions; a session does not keep their samples."""


def write_session(session_path: Path, bag_path: Path, compression: str = "none") -> int:
    """Write a session's observations, images, states and measures into a new bag.

    Velocities are not stored in a session and are written as 0. A bag that could not be completed is removed.

    Args:
        session_path: Folder of the session.
        bag_path: The bag to write; must not exist.
        compression: none, bz2 or lz4.

    Returns:
        The number of observations.

    Raises:
        SessionError: The session cannot be read.
        BagError: The bag cannot be written.
    """
    bag_path = Path(bag_path)
    if bag_path.suffix != ".bag":
        raise BagError(f"invalid bag name {bag_path}: it must end in .bag")
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
                measures = {name: float(rows[name][steps[index + 1]]) for name in STEP_COLUMNS}
                message = TargetDistribution(header=state.header, step=index + 1, **measures)
                bag.write(f"/{names.TARGET_DISTRIBUTION}", message, stamp)
        return len(store)


def read_session(recording: Recording, config: Config) -> Path:
    """Store a recording's observations, and its measures if none was lost, in a new session; return its folder.

    Raises SessionError if the session exists, and as Recording.observations() does; the session is then removed.
    """
    with Session.open_for_writing(config) as session:
        try:
            _fill(session, recording)
        except BaseException:
            shutil.rmtree(session.paths.path, ignore_errors=True)
            raise
        return session.paths.path


def recorded_stamp(seconds: float) -> rospy.Time:
    """Convert stored seconds to a stamp, to the nanosecond. Raises BagError outside the range of ROS times."""
    whole = int(seconds // 1.0)
    nanoseconds = round((seconds - whole) * 1e9)
    if not 0 <= whole < 2**32 - 1:
        raise BagError(f"cannot write the stamp {seconds!r} s into a bag: it is outside the range of ROS times")
    return rospy.Time(whole, nanoseconds)


def _fill(session: Session, recording: Recording) -> None:
    """Append observations up to the configured number of steps, then their measures."""
    camera = session.config.camera
    rows: List[Dict[str, float]] = []
    with session.open_observations() as store:
        for observation in recording.observations(session.config):
            if len(store) == session.config.exploration.steps:
                break
            state, stamp = state_arrays(observation.state)[0].tolist(), observation.header.stamp.to_sec()
            store.append(observation.index, stamp, state, image_array(observation.image, camera.height, camera.width))
            rows.append({"time": stamp, **dict(zip(STATE_NAMES, state))})
    if recording.lost or not recording.has_observations:
        return
    with session.open_table("exploration") as table:
        for message in recording.measures():
            if message.step <= len(rows):
                measures = {name: getattr(message, name) for name in STEP_COLUMNS}
                table.append({"step": message.step, **rows[message.step - 1], **measures})
