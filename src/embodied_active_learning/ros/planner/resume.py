"""Exact resume of the planner: its state is saved before each observation and loaded when the node starts."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple, Optional, Tuple

import numpy as np
import rospy

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CommandError, CorruptFileError
from embodied_active_learning.exploration.commands import PoseCommand
from embodied_active_learning.msg import PlanarState
from embodied_active_learning.pipeline.exploration import ExplorationRun
from embodied_active_learning.ros import names
from embodied_active_learning.ros.arm.retrying_arm import RetryingArm
from embodied_active_learning.ros.conversions import state_arrays, state_message
from embodied_active_learning.ros.runtime.services import is_advertised
from embodied_active_learning.session.paths import SessionPaths
from embodied_active_learning.session.planner_state import PlannerState, load_planner_state, save_planner_state


class ResumePoint(NamedTuple):
    """A run just before an observation, and the state of that observation."""

    run: ExplorationRun
    state: PlanarState  # a simulated arm can return to this stamp
    is_stored: bool  # whether the trainer has stored the observation


class PlannerResume:
    """Saves and loads the planner's state in the session's folder."""

    def __init__(self, config: Config, session: Path) -> None:
        self._config = config
        self._path = SessionPaths(session).planner

    def save(self, run: ExplorationRun, state: PlanarState) -> None:
        """Save a run and the state of the observation that is sent next.

        Raises:
            SessionError: The disk fails.
        """
        stamp = state.header.stamp
        pose, velocity = state_arrays(state)
        planner = PlannerState(run.step, (stamp.secs, stamp.nsecs), pose, velocity, run.state_dict())
        save_planner_state(self._path, planner)

    def load(self, trajectory: np.ndarray) -> Optional[ResumePoint]:
        """Load the run that was saved before the newest stored observation, or before the next one.

        Args:
            trajectory: (N, 3) states of the stored observations.

        Returns:
            None for a new run, and, with a warning, if the saved state is damaged or of other observations.
        """
        stored = len(trajectory)
        try:
            planner = load_planner_state(self._path)
            if planner is None and not stored:
                return None
            if planner is None or planner.index not in (stored - 1, stored):
                raise CorruptFileError(f"{self._path} does not belong to observation {stored}, the next one")
            if planner.index < stored and not np.array_equal(planner.state, trajectory[-1]):
                raise CorruptFileError(f"{self._path} is of another run: the newest observation has another state")
            run = ExplorationRun(self._config, trajectory[: planner.index])
            run.load_state_dict(planner.run)
        except CorruptFileError as error:
            rospy.logwarn("resuming from the stored observations, with other random draws: %s", error)
            return None
        state = state_message(rospy.Time(*planner.stamp), planner.state, planner.velocity)
        return ResumePoint(run, state, planner.index < stored)

    def return_arm(self, point: ResumePoint, arm: RetryingArm) -> Tuple[PlanarState, PlanarState]:
        """Return the arm to a resume point: a simulated arm exactly, any other to the same pose, at rest.

        Returns:
            The state reached, and the observation's state with the velocity from which the run continues.

        Raises:
            CommandError, ShutdownRequestedError: See RetryingArm.
        """
        if is_advertised(names.ARM_RESTORE):
            try:
                return arm.restore(point.state), point.state
            except CommandError as error:  # for instance if the arm's limits have been changed since
                rospy.logwarn("arm returns to the last pose; the run is no longer bit-identical: %s", error)
        point.run.interrupt()
        pose, _ = state_arrays(point.state)
        reached = arm.execute(PoseCommand.from_array(self._config.workspace.box().clip(pose)))
        return reached, state_message(point.state.header.stamp, pose, np.zeros(3))
