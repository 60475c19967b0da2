"""What a recorded run holds for learning: its observations in their order, and the settings it was made with."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path
from typing import Any, Dict, Iterator, List, Set, Tuple, Type

import genpy
import rospy
import yaml
from sensor_msgs.msg import Image
from std_msgs.msg import String

from embodied_active_learning.config import Config
from embodied_active_learning.errors import BagError, ConfigError, ObservationError
from embodied_active_learning.files import LARGEST_YAML, parse_yaml, shown
from embodied_active_learning.msg import Observation, PlanarState, TargetDistribution
from embodied_active_learning.ros import names
from embodied_active_learning.ros.bags.pairing import RecordedPairs, model_image
from embodied_active_learning.ros.bags.reader import BagFile, BagMessage, Connection

SUFFIXES = (".bag", ".bag.active")
_CLASSES: Dict[str, Type[genpy.Message]] = {
    names.OBSERVATION: Observation,
    names.CAMERA_IMAGE: Image,
    names.ARM_STATE: PlanarState,
    names.TARGET_DISTRIBUTION: TargetDistribution,
    names.RUN_CONFIG: String,
}
_MOST_TOLD = 8  # topics or reasons that a message names


class Recording:
    """The bags of one run, one after the other."""

    def __init__(self, path: Path, namespace: str = "") -> None:
        """path: a bag, or a folder whose bags are read in the order of their names, as those of a run that was resumed.

        namespace: of the system that was recorded; empty where there is only one. Raises BagError when there is
        nothing to learn from.
        """
        self.path = Path(os.path.abspath(os.path.expanduser(path)))
        self.bags = [BagFile(found) for found in _bags(self.path)]
        self.lost = 0
        """Observations that were made but not recorded, as far as the last one who went through them has seen."""
        self._refused: Counter = Counter()
        self._settings: Dict[str, str] = {}
        topics = self._survey()
        self._namespace = self._find_namespace(topics, namespace)
        self.has_observations = self._name(names.OBSERVATION) in topics
        if not (self.has_observations or {self._name(names.CAMERA_IMAGE), self._name(names.ARM_STATE)} <= topics):
            raise BagError(
                f"{self.path} holds neither {self._name(names.OBSERVATION)} nor both {self._name(names.CAMERA_IMAGE)} "
                f"and {self._name(names.ARM_STATE)}: record them; there are {_told(topics)}"
            )

    @property
    def unclosed(self) -> List[Path]:
        """The bags whose recorder was killed: what they hold is read up to where they break off."""
        return [bag.path for bag in self.bags if not bag.closed]

    @property
    def refused(self) -> str:
        """Why images were left out that a planner would refuse, as far as one has gone through them; empty for none."""
        return "; ".join(f"{reason} ({count} times)" for reason, count in self._refused.most_common(_MOST_TOLD))

    def settings(self) -> Dict[str, Any]:
        """Sections of keys: what the run was configured with, less its session; nothing where that is not recorded.

        Raises ConfigError when this version cannot use them.
        """
        text = self._settings.get(self._name(names.RUN_CONFIG), "")
        if not text:
            return {}
        try:
            return read_settings(text)
        except ValueError as error:
            raise ConfigError(
                f"{self.path}: the recorded settings cannot be used ({error}): replay it by the version that has "
                "recorded it"
            ) from error

    def count(self, config: Config) -> int:
        """How many observations there are for a configuration. Raises as observations does."""
        return sum(1 for _ in self.observations(config))

    def observations(self, config: Config) -> Iterator[Observation]:
        """The observations, numbered from 0 whatever was lost, as the trainer takes them.

        Raises BagError for a damaged bag and where there are none at all, ObservationError for images that the
        configured model does not take.
        """
        found = self._recorded(config) if self.has_observations else self._paired(config)
        index = -1
        for index, observation in enumerate(found):
            observation.index = index
            yield observation
        if index < 0:
            raise BagError(f"{self.path} holds no observation that can be used: see whether it is of the right run")

    def measures(self) -> Iterator[TargetDistribution]:
        """What was told of each step, in their order and each once. Raises BagError for a damaged bag."""
        last = 0
        for _, message in self._messages((names.TARGET_DISTRIBUTION,)):
            if message.step > last:
                last = message.step
                yield message

    def _recorded(self, config: Config) -> Iterator[Observation]:
        """Observations as they were handed to the trainer, each once: a resumed run may have told one again."""
        self.lost, last = 0, -1
        for _, observation in self._messages((names.OBSERVATION,)):
            if observation.index <= last:
                continue
            self.lost += observation.index - last - 1
            last = observation.index
            observation.image = model_image(observation.image, config.camera)
            yield observation

    def _paired(self, config: Config) -> Iterator[Observation]:
        """Observations made of images and arm states."""
        pairs, any_yet = RecordedPairs(config), False
        self._refused = pairs.refused
        for name, message in self._messages((names.CAMERA_IMAGE, names.ARM_STATE)):
            add = pairs.add_image if name == names.CAMERA_IMAGE else pairs.add_state
            for image, state in add(message):
                any_yet = True
                yield Observation(state.header, 0, state, image)
        if self.refused and not any_yet:
            raise ObservationError(f"{self.path}: no image goes with a state of the arm: {self.refused}")

    def _messages(self, wanted: Tuple[str, ...]) -> Iterator[Tuple[str, genpy.Message]]:
        """Messages by the relative names of their topics."""
        topics = {self._name(name): name for name in wanted}
        for bag in self.bags:
            for message in bag.read(lambda connection: _absolute(connection.topic) in topics):
                name = topics[_absolute(message.connection.topic)]
                yield name, _message(bag, message, _CLASSES[name])

    def _survey(self) -> Set[str]:
        """The topics of all bags; keeps the newest settings on the way."""
        topics: Set[str] = set()

        def wanted(connection: Connection) -> bool:
            topics.add(_absolute(connection.topic))
            return _absolute(connection.topic).endswith(f"/{names.RUN_CONFIG}")

        for bag in self.bags:
            for message in bag.read(wanted):
                self._settings[_absolute(message.connection.topic)] = _message(bag, message, String).data
        return topics

    def _find_namespace(self, topics: Set[str], given: str) -> str:
        if given.strip("/"):
            return f"/{given.strip('/')}"
        for name in (names.OBSERVATION, names.CAMERA_IMAGE):
            spaces = sorted(topic[: -len(name) - 1] for topic in topics if topic.endswith(f"/{name}"))
            if len(spaces) > 1:
                told = ", ".join(space or "/" for space in spaces)
                raise BagError(f"{self.path} holds several systems, {told}: say which one by namespace:=")
            if spaces:
                return spaces[0]
        return ""

    def _name(self, name: str) -> str:
        return f"{self._namespace}/{name}"


def settings_text(config: Config) -> str:
    """What a bag tells of the configuration that it was made with: everything but where it lay on that computer."""
    values = config.to_dict()
    values.pop("session")
    values["simulation"]["world"] = Path(config.simulation.world).stem
    return yaml.safe_dump(values, sort_keys=False)


def read_settings(text: str) -> Dict[str, Any]:
    """Sections of keys as settings_text has written them. Raises ValueError for what is none, or of another version."""
    if len(text) > LARGEST_YAML:
        raise ValueError(f"it has {len(text)} characters, and {LARGEST_YAML} are allowed")
    values = Config.from_dict(parse_yaml(text)).to_dict()
    values.pop("session")
    return values


def recorded_stamp(seconds: float) -> rospy.Time:
    """Stored seconds as a stamp, to the nanosecond. Raises BagError for a time that no stamp can tell."""
    whole = int(seconds // 1.0)
    nanoseconds = round((seconds - whole) * 1e9)
    if not 0 <= whole < 2**32 - 1:
        raise BagError(f"the stamp {seconds!r} s cannot be written into a bag: it is none that ROS gives")
    return rospy.Time(whole, nanoseconds)


def _bags(path: Path) -> List[Path]:
    if not path.is_dir():
        return [path]
    found = sorted(item for item in path.iterdir() if item.name.endswith(SUFFIXES))
    if not found:
        raise BagError(f"{path} holds no bag: give the path of one, or the folder bags/ of a session")
    return found


def _message(bag: BagFile, message: BagMessage, expected: Type[genpy.Message]) -> genpy.Message:
    """A message of a class that is expected. Raises BagError for another one, or a damaged one."""
    connection = message.connection
    if (connection.datatype, connection.md5sum) != (expected._type, expected._md5sum):
        raise BagError(
            f"{bag.path}: {connection.topic} is {shown(connection.datatype)} of another version than this package's "
            f"{expected._type}: convert it with rosbag fix, or use the version that has recorded it"
        )
    try:
        return expected().deserialize(message.data)
    except (genpy.DeserializationError, ValueError) as error:
        raise BagError(f"{bag.path}: a message of {connection.topic} is damaged ({error}): use another bag") from error


def _absolute(topic: str) -> str:
    return f"/{topic.lstrip('/')}"


def _told(topics: Set[str]) -> str:
    more = f", and {len(topics) - _MOST_TOLD} more" if len(topics) > _MOST_TOLD else ""
    return (", ".join(sorted(topics)[:_MOST_TOLD]) or "no messages at all") + more
