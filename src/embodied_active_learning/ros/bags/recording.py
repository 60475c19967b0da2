"""A recorded run: its observations in order, its measures, and its settings."""

from __future__ import annotations

import os
import re
import zlib
from collections import Counter
from pathlib import Path
from typing import Any, Dict, Iterator, List, Set, Tuple, Type, Union

import genpy
import rospy
from sensor_msgs.msg import Image
from std_msgs.msg import String

from embodied_active_learning.config import Config
from embodied_active_learning.errors import BagError, ConfigError, ObservationError
from embodied_active_learning.files import MAX_YAML_SIZE, short_repr
from embodied_active_learning.msg import Observation, PlanarState, TargetDistribution
from embodied_active_learning.ros import names
from embodied_active_learning.ros.bags.pairing import RecordedPairs, model_image
from embodied_active_learning.ros.bags.reader import BagFile, BagMessage, Connection
from embodied_active_learning.ros.bags.run_filter import RunFilter
from embodied_active_learning.ros.bags.run_settings import read_settings

SUFFIXES = (".bag", ".bag.active")
_CLASSES: Dict[str, Type[genpy.Message]] = {
    names.OBSERVATION: Observation,
    names.CAMERA_IMAGE: Image,
    names.ARM_STATE: PlanarState,
    names.TARGET_DISTRIBUTION: TargetDistribution,
    names.RUN_CONFIG: String,
}
_OVERLAP_TOLERANCE = rospy.Duration(1)
_MAX_SYSTEMS = 64  # recorded in one bag
_MAX_LISTED = 8  # topics or reasons in a message


class Recording:
    """The bags of one run, ordered by the stamp of their first message."""

    def __init__(self, path: Path, namespace: str = "") -> None:
        """Open a bag, or all bags of a folder.

        Args:
            path: A bag, or a folder with the bags of one run (split, or resumed).
            namespace: Namespace of the recorded system; required if the bags hold several.

        Raises:
            BagError: No bag, a damaged bag, or nothing to learn from.
        """
        self.path = Path(os.path.abspath(os.path.expanduser(path)))
        self.bags = [BagFile(found) for found in _find_bags(self.path)]
        self.lost = 0
        """Observations of the run that were not recorded, after observations() has been read."""
        self._other_runs = self._repeated = 0
        self._rejected: Counter = Counter()
        self._settings: Dict[Path, Dict[str, str]] = {}  # bag -> topic -> first message
        topics = self._survey()
        self._namespace = self._find_namespace(topics, namespace)
        self.has_observations = self._absolute_name(names.OBSERVATION) in topics
        image, state = self._absolute_name(names.CAMERA_IMAGE), self._absolute_name(names.ARM_STATE)
        if not (self.has_observations or {image, state} <= topics):
            raise BagError(
                f"{self.path} has no topic {self._absolute_name(names.OBSERVATION)}, nor both {image} and {state}: "
                f"record them; topics found: {_listed(topics)}"
            )
        self._starts = self._sort_bags()

    @property
    def rejected(self) -> str:
        """Reasons why images were rejected, after observations() has been read; empty if none was."""
        return "; ".join(f"{reason} ({count} images)" for reason, count in self._rejected.most_common(_MAX_LISTED))

    def warnings(self) -> List[str]:
        """Return what was missing or left out, after observations() has been read."""
        found = [f"{bag.path} is incomplete: its recorder was killed; using what it has" for bag in self._unclosed()]
        if self.lost:
            found.append(f"{self.lost} observations of the run were not recorded: the others are used")
        if self._other_runs:
            found.append(
                f"{self.path} holds more than one run: the first one is used, {self._other_runs} observations of "
                "others are left out; extract them by time with rosbag filter to use them"
            )
        if self._repeated:
            found.append(f"{self._repeated} observations were recorded twice with different content: the first is used")
        if self.rejected:
            found.append(f"recorded images were rejected: {self.rejected}")
        return found

    def settings(self) -> Dict[str, Any]:
        """Return the run's configuration as sections of keys, without its session; empty if it was not recorded.

        Raises ConfigError if this version cannot use it.
        """
        topic = self._absolute_name(names.RUN_CONFIG)
        text = next((self._settings[bag.path][topic] for bag in self.bags if topic in self._settings[bag.path]), "")
        if not text:
            return {}
        try:
            return read_settings(text)
        except ValueError as error:
            raise ConfigError(
                f"{self.path}: invalid recorded settings: {error}; replay the bag with the version that recorded it, "
                f"or without its settings (rosbag filter IN.bag OUT.bag \"topic != '{topic}'\") and with profile:="
            ) from error

    def count(self, config: Config) -> int:
        """Return the number of observations for a configuration. Raises as observations() does."""
        return sum(1 for _ in self.observations(config))

    def observations(self, config: Config) -> Iterator[Observation]:
        """Yield the observations, numbered consecutively from 0, with images of the model's size.

        Raises:
            BagError: A bag is damaged, or there is no observation.
            ObservationError: The images are unusable.
        """
        found = self._recorded(config) if self.has_observations else self._paired(config)
        index = -1
        for index, observation in enumerate(found):
            observation.index = index
            yield observation
        if index < 0:
            raise BagError(f"{self.path} has no usable observation: check that it is a recording of a learning run")

    def measures(self) -> Iterator[TargetDistribution]:
        """Yield the target distribution of each step once, in order. Raises BagError for a damaged bag."""
        run = RunFilter(last=0)
        for _, message in self._messages((names.TARGET_DISTRIBUTION,)):
            if run.accept(message.step, (message.header.stamp.to_nsec(), message.ergodic_measure, message.distance)):
                yield message

    def _recorded(self, config: Config) -> Iterator[Observation]:
        """Yield the observations that were sent to the trainer."""
        run = RunFilter(last=-1)
        for _, observation in self._messages((names.OBSERVATION,)):
            accepted = run.accept(
                observation.index, (observation.header.stamp.to_nsec(), zlib.crc32(observation.image.data))
            )
            self.lost, self._other_runs, self._repeated = run.lost, run.other_runs, run.repeated
            if accepted:
                observation.image = model_image(observation.image, config.camera)
                yield observation

    def _paired(self, config: Config) -> Iterator[Observation]:
        """Yield observations made from images and arm states."""
        pairs, empty = RecordedPairs(config), True
        self._rejected = pairs.rejected
        for name, message in self._messages((names.CAMERA_IMAGE, names.ARM_STATE)):
            add = pairs.add_image if name == names.CAMERA_IMAGE else pairs.add_state
            for image, state in add(message):
                empty = False
                yield Observation(state.header, 0, state, image)
        if self.rejected and empty:
            raise ObservationError(f"{self.path}: no image matches an arm state: {self.rejected}")

    def _messages(self, wanted: Tuple[str, ...]) -> Iterator[Tuple[str, genpy.Message]]:
        """Yield messages with the relative names of their topics."""
        for bag, following in zip(self.bags, [*self._starts[1:], None]):
            for name, message in self._read(bag, wanted):
                self._check_overlap(bag, message, following)
                yield name, message

    def _read(self, bag: BagFile, wanted: Tuple[str, ...]) -> Iterator[Tuple[str, genpy.Message]]:
        topics = {self._absolute_name(name): name for name in wanted}
        for message in bag.read(lambda connection: _absolute(connection.topic) in topics):
            name = topics[_absolute(message.connection.topic)]
            yield name, _deserialise(bag, message, _CLASSES[name])

    def _check_overlap(self, bag: BagFile, message: genpy.Message, following: Union[rospy.Time, None]) -> None:
        """Reject bags recorded at the same time: images and states would be read in the wrong order."""
        if following is None or self.has_observations or message.header.stamp <= following + _OVERLAP_TOLERANCE:
            return
        raise BagError(
            f"{bag.path} overlaps in time with another bag in {self.path}: record images and arm states into one bag, "
            "or give a single bag"
        )

    def _survey(self) -> Set[str]:
        """Return the topics of all bags, and store the first settings of each bag."""
        topics: Set[str] = set()

        def wanted(connection: Connection) -> bool:
            topics.add(_absolute(connection.topic))
            return _absolute(connection.topic).endswith(f"/{names.RUN_CONFIG}")

        for bag in self.bags:
            found = self._settings[bag.path] = {}
            for message in bag.read(wanted):
                text = _deserialise(bag, message, String).data
                found.setdefault(_absolute(message.connection.topic), text[: MAX_YAML_SIZE + 1])
                if len(found) > _MAX_SYSTEMS:
                    raise BagError(f"{bag.path} has more than {_MAX_SYSTEMS} topics {names.RUN_CONFIG}: filter the bag")
        return topics

    def _sort_bags(self) -> List[rospy.Time]:
        """Sort the bags by first stamp, equal ones by name, those without messages last; return first stamps."""
        if len(self.bags) == 1:
            return [rospy.Time()]
        starts = {bag.path: self._first_stamp(bag) for bag in self.bags}
        self.bags.sort(key=lambda bag: (starts[bag.path], _natural_order(bag.path.name)))
        return [starts[bag.path] for bag in self.bags]

    def _first_stamp(self, bag: BagFile) -> rospy.Time:
        wanted = (names.OBSERVATION,) if self.has_observations else (names.CAMERA_IMAGE, names.ARM_STATE)
        for _, message in self._read(bag, wanted):
            if not message.header.stamp.is_zero():
                return message.header.stamp
        return rospy.Time(2**32 - 1)

    def _unclosed(self) -> List[BagFile]:
        return [bag for bag in self.bags if not bag.closed]

    def _find_namespace(self, topics: Set[str], given: str) -> str:
        if given.strip("/"):
            return f"/{given.strip('/')}"
        for name in (names.OBSERVATION, names.CAMERA_IMAGE):
            spaces = sorted(topic[: -len(name) - 1] for topic in topics if topic.endswith(f"/{name}"))
            if len(spaces) > 1:
                listed = _listed({space or "/" for space in spaces})
                raise BagError(f"{self.path} has several systems, {listed}: select one with namespace:=")
            if spaces:
                return spaces[0]
        return ""

    def _absolute_name(self, name: str) -> str:
        return f"{self._namespace}/{name}"


def _find_bags(path: Path) -> List[Path]:
    if not path.is_dir():
        return [path]
    found = [item for item in path.iterdir() if item.name.endswith(SUFFIXES)]
    if not found:
        raise BagError(f"no bag in {path}: give the path of one, or the folder bags/ of a session")
    return found


def _natural_order(name: str) -> List[Tuple[int, str]]:
    """Sort key that orders run_2 before run_10."""
    return [(int(part) if part.isdecimal() else -1, part) for part in re.split(r"(\d+)", name)]


def _deserialise(bag: BagFile, message: BagMessage, expected: Type[genpy.Message]) -> genpy.Message:
    """Deserialise a message of the expected class. Raises BagError for another class, or a malformed message."""
    connection = message.connection
    if (connection.datatype, connection.md5sum) != (expected._type, expected._md5sum):
        raise BagError(
            f"{bag.path}: {connection.topic} has type {short_repr(connection.datatype)} with another MD5 sum than "
            f"{expected._type}: convert it with rosbag fix, or use the version that recorded it"
        )
    try:
        return expected().deserialize(message.data)
    except (genpy.DeserializationError, ValueError) as error:
        raise BagError(f"{bag.path}: malformed message on {connection.topic}: {error}; use another bag") from error


def _absolute(topic: str) -> str:
    return f"/{topic.lstrip('/')}"


def _listed(topics: Set[str]) -> str:
    more = f", and {len(topics) - _MAX_LISTED} more" if len(topics) > _MAX_LISTED else ""
    return (", ".join(sorted(topics)[:_MAX_LISTED]) or "none") + more
