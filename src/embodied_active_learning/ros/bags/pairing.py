"""Observations from recorded images and arm states: the pairing that a planner does while it runs, done afterwards."""

from __future__ import annotations

from collections import Counter, deque
from typing import Deque, Iterator, Optional, Tuple

import rospy
from sensor_msgs.msg import Image

from embodied_active_learning.config import CameraConfig, Config
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.images import Framing, decode_raw
from embodied_active_learning.msg import PlanarState
from embodied_active_learning.ros.camera.image_buffer import STILL_DISTANCE, STILL_TURN, ImageBuffer
from embodied_active_learning.ros.camera.pose_buffer import KEPT, PoseBuffer, moved
from embodied_active_learning.ros.conversions import image_message, state_arrays

EARLIER = 0.001
"""Seconds that a period may be shorter than asked for: stamps are not exact."""
OUTSIDE = 0.05
"""How far outside of the workspace, in half workspaces, images still count: the rest is no exploration."""


Pair = Tuple[Image, PlanarState]
"""An image of the model's size, and the state that it was taken from, at the image's stamp."""


class RecordedPairs:
    """One pair for each step of exploration: an image that is as good as a planner asks for, from another place.

    Messages go in as they were recorded; an image waits for the state after it, and is interpolated between two.
    """

    def __init__(self, config: Config) -> None:
        self._step = config.exploration.step_duration
        self._camera = config.camera
        self._workspace = config.workspace.box()
        self._poses = PoseBuffer(config)
        self._images = ImageBuffer(config.camera, self._poses)
        self._waiting: Deque[Image] = deque(maxlen=KEPT)
        self._last: Optional[PlanarState] = None
        self.refused: Counter = Counter()
        """Why images could not be used, in words, and how many."""

    def add_image(self, image: Image) -> Iterator[Pair]:
        """Take in an image -> the pairs that this makes, mostly none."""
        self._waiting.append(image)
        return self._pairs()

    def add_state(self, state: PlanarState) -> Iterator[Pair]:
        """Take in a state of the arm -> the pairs that this makes: of images that have waited for it."""
        self._poses.add(state)
        try:
            self._poses.raise_jump()
        except ObservationError as error:
            self.refused[str(error)] += 1
        return self._pairs()

    def _pairs(self) -> Iterator[Pair]:
        newest = self._poses.newest
        while newest is not None and self._waiting and self._waiting[0].header.stamp <= newest:
            pair = self._pair(self._waiting.popleft())
            if pair is not None:
                yield pair

    def _pair(self, image: Image) -> Optional[Pair]:
        last = None if self._last is None else self._last.header.stamp
        if not is_due(image.header.stamp, last, self._step):
            return None
        try:
            state = self._poses.at(image.header.stamp)
            if not self._is_wanted(state):
                return None
            image = model_image(image, self._camera)
            self._images.add(image, image.header.stamp)
            self._images.view(state)
        except ObservationError as error:
            self.refused[str(error)] += 1
            return None
        self._last = state
        return image, state

    def _is_wanted(self, state: PlanarState) -> bool:
        """Whether the arm is in the workspace, and has moved since the last pair."""
        inside = self._workspace.contains(state_arrays(state)[0], OUTSIDE)
        return bool(inside) and (self._last is None or moved(self._last, state, STILL_DISTANCE, STILL_TURN))


def is_due(stamp: rospy.Time, last: Optional[rospy.Time], period: float) -> bool:
    """Whether a period [s] has passed since the last one, there was none, or time has gone back."""
    elapsed = None if last is None else (stamp - last).to_sec()
    return elapsed is None or elapsed < 0.0 or elapsed >= period - EARLIER


def model_image(picture: Image, camera: CameraConfig) -> Image:
    """A recorded picture of any size as the model takes it, cropped in its middle and scaled.

    Raises ObservationError for one that is damaged, or of an encoding that cannot be decoded.
    """
    array = decode_raw(picture.data, picture.encoding, picture.height, picture.width, picture.step)
    framing = Framing.between((picture.height, picture.width), (camera.height, camera.width))
    return image_message(picture.header.stamp, framing.apply(array))
