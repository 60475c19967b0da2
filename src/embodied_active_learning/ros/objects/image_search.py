"""Runs an identification over the images of a session while they are stored."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, List

import rospy

from embodied_active_learning.config import Config
from embodied_active_learning.errors import EmbodiedActiveLearningError, SessionError
from embodied_active_learning.objects.decision import Decision
from embodied_active_learning.pipeline.identification import IdentificationRun, read_sets
from embodied_active_learning.ros.objects.identification_output import IdentificationOutput
from embodied_active_learning.ros.runtime.diagnostics import Rate
from embodied_active_learning.ros.runtime.node import wait_until, wall_sleep
from embodied_active_learning.ros.runtime.task_server import TaskProgress
from embodied_active_learning.ros.trainer.client import save_model
from embodied_active_learning.session.observations import DATA_FILE
from embodied_active_learning.session.paths import SessionPaths
from embodied_active_learning.session.session import find_session, session_path, session_root

_PUBLISH_PERIOD = 2.0  # wall seconds
_LOG_PERIOD = 5.0  # wall seconds
_POLL_PERIOD = 0.1
"""Wall seconds between checks for new images."""


class ImageSearch:
    """Searches for fingerprints in every image of a session; none is skipped, because they are read from its store."""

    def __init__(self, config: Config) -> None:
        """Use the session root, the running session and the identification settings of a configuration."""
        self._config = config
        self._root = session_root(config)
        self._outputs = IdentificationOutput()
        self.image_rate = Rate()

    def open_run(self, request: Any, name: str, progress: TaskProgress) -> IdentificationRun:
        """Read the fingerprints and open the session with the images; wait for the first image of a running one.

        Args:
            request: Request of the service or goal of the action /identify.
            name: Name of the results.
            progress: Of the task.

        Raises:
            SessionError: If a session does not exist or has too few images, or if the name is in use.
        """
        progress.report("reading fingerprints")
        sets = read_sets(self._root, request.sessions)
        images, stored = request.images, bool(request.replay)
        if stored:
            path = find_session(self._root, request.replay, "replay")
        else:
            path, images = self._running_session(images, progress), images or self._config.exploration.steps
        settings = self._config.identification
        return IdentificationRun(path, sets, name, images, settings, request.overwrite, must_be_stored=stored)

    def search(self, run: IdentificationRun, progress: TaskProgress) -> List[Decision]:
        """Process images until they change no decision or all are processed; store and publish the decisions."""
        self._process_images(run, progress)
        progress.report("deciding")
        rospy.loginfo("%d of at most %d images processed; deciding", run.processed, run.max_images)
        decisions = run.decide()
        progress.check()
        run.save(decisions)
        self._outputs.publish_result(run.identification.targets, run.processed, decisions, run.unknown)
        return decisions

    def store_model(self) -> None:
        """Store the model that is learned while identifying, so that its session can be resumed and fingerprinted."""
        if not self._config.training.updates_per_observation:
            return
        try:
            save_model()
        except EmbodiedActiveLearningError as error:
            rospy.logwarn("the model of the searched workspace is not stored: %s", error)
        else:
            name = self._config.session.name
            rospy.loginfo("model of the searched workspace: session %s; learn.launch resume:=true continues it", name)

    def _running_session(self, images: int, progress: TaskProgress) -> Path:
        """Return the folder of the running session once it has an image."""
        path, steps = session_path(self._config), self._config.exploration.steps
        if images > steps:
            raise SessionError(
                f"too few images: {images} requested, but the run ends after {steps} (exploration/steps); request at "
                f"most {steps}"
            )
        first = SessionPaths(path).observations / DATA_FILE

        def has_image() -> bool:
            progress.check()
            return first.is_file()

        wait_until(has_image, lambda: f"the first image of {path}")
        return path

    def _process_images(self, run: IdentificationRun, progress: TaskProgress) -> None:
        """Process images until the run is complete; log and publish the beliefs periodically."""
        publish_at = log_at = time.monotonic() + _POLL_PERIOD
        while not run.complete:
            count = run.advance()
            if count:
                self.image_rate.tick(count)
                self._outputs.publish_open_places(run.identification.open_places)
            wall_sleep(0.0 if count else _POLL_PERIOD)
            progress.report("searching", run.processed, run.max_images)
            if time.monotonic() >= log_at:
                targets = len(run.identification.targets)
                rospy.loginfo("searching for %d fingerprints: image %d of %d", targets, run.processed, run.max_images)
                log_at = time.monotonic() + _LOG_PERIOD
            if time.monotonic() >= publish_at:
                self._outputs.publish_beliefs(run.identification.targets, run.processed)
                publish_at = time.monotonic() + _PUBLISH_PERIOD
