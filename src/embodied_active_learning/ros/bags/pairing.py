"""Pair recorded images with recorded arm states, as the planner does during a run."""

from __future__ import annotations

import zlib
from collections import Counter, deque
from typing import Deque, Iterator, Optional, Set, Tuple

import rospy
from sensor_msgs.msg import Image

from embodied_active_learning.config import CameraConfig, Config
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.images import Framing
from embodied_active_learning.msg import PlanarState
from embodied_active_learning.ros.camera.image_buffer import STILL_DISTANCE, STILL_TURN, ImageBuffer, exposure_stamp
from embodied_active_learning.ros.camera.pose_buffer import CAPACITY, PoseBuffer, moved
from embodied_active_learning.ros.conversions import decode_image, image_message, state_arrays

PERIOD_TOLERANCE = 0.001
"""Seconds by which a period may be shorter than requested, for inexact stamps."""
WORKSPACE_TOLERANCE = 0.05
"""Distance outside the workspace, in half workspaces, up to which images are used."""
MAX_WAITING = 2**28
"""Maximum size in bytes of the images held back until a state arrives; the oldest are dropped."""


StampedPair = Tuple[Image, PlanarState]
"""An image of the model's size, and the arm state interpolated at its stamp."""


class RecordedPairs:
    """Selects one pair per exploration step: an image the planner would accept, from a new position.

    Messages are added in recorded order. An image is held back until the first state after it arrives.
    """

    def __init__(self, config: Config) -> None:
        self._step = config.exploration.step_duration
        self._camera = config.camera
        self._workspace = config.workspace.box()
        self._poses = PoseBuffer(config)
        self._images = ImageBuffer(config.camera, self._poses)
        self._waiting: Deque[Image] = deque(maxlen=CAPACITY)
        self._last: Optional[PlanarState] = None
        self._seen: Set[Tuple[int, int]] = set()  # stamp (ns) and checksum of every image
        self.rejected: Counter = Counter()
        """Number of rejected images by reason."""

    def add_image(self, image: Image) -> Iterator[StampedPair]:
        """Add an image and yield the pairs it completes; a repetition is skipped."""
        identity = image.header.stamp.to_nsec(), zlib.crc32(image.data)
        if identity in self._seen:
            return iter(())
        self._seen.add(identity)
        if image.header.stamp.is_zero():
            self.rejected["the images have no time stamp (header.stamp is 0); record a camera driver that sets it"] += 1
            return iter(())
        image.header.stamp = exposure_stamp(image.header.stamp, self._camera.latency)
        self._waiting.append(image)
        while sum(len(item.data) for item in self._waiting) > MAX_WAITING:
            self._waiting.popleft()
        return self._pairs()

    def add_state(self, state: PlanarState) -> Iterator[StampedPair]:
        """Add an arm state and yield the pairs it completes."""
        self._poses.add(state)
        try:
            self._poses.raise_jump()
        except ObservationError as error:
            self.rejected[str(error)] += 1
        return self._pairs()

    def _pairs(self) -> Iterator[StampedPair]:
        newest = self._poses.newest
        while newest is not None and self._waiting and self._waiting[0].header.stamp <= newest:
            pair = self._pair(self._waiting.popleft())
            if pair is not None:
                yield pair

    def _pair(self, image: Image) -> Optional[StampedPair]:
        stamp = image.header.stamp
        last = None if self._last is None else self._last.header.stamp
        if not is_due(stamp, last, self._step):
            return None
        try:
            state = self._poses.at(stamp)
            if not self._is_wanted(state):
                return None
            image = model_image(image, self._camera)
            self._images.add(image, stamp)
            self._images.accept(state)
        except ObservationError as error:
            self.rejected[str(error)] += 1
            return None
        self._last = state
        return image, state

    def _is_wanted(self, state: PlanarState) -> bool:
        """Return whether the camera is in the workspace and has moved since the last pair."""
        inside = self._workspace.contains(state_arrays(state)[0], WORKSPACE_TOLERANCE)
        return bool(inside) and (self._last is None or moved(self._last, state, STILL_DISTANCE, STILL_TURN))


def is_due(stamp: rospy.Time, last: Optional[rospy.Time], period: float) -> bool:
    """Return whether a period (s) has passed since the last stamp, there was none, or time went back."""
    elapsed = None if last is None else (stamp - last).to_sec()
    return elapsed is None or elapsed < 0.0 or elapsed >= period - PERIOD_TOLERANCE


def model_image(image: Image, camera: CameraConfig) -> Image:
    """Crop the centre of a recorded image and scale it to the model's size.

    Raises ObservationError for a malformed image or an unsupported encoding.
    """
    array = decode_image(image)  # before its size is used
    framing = Framing.between(array.shape[:2], (camera.height, camera.width))
    return image_message(image.header.stamp, framing.apply(array))
