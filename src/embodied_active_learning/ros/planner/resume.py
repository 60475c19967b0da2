"""The planner's memory between two lives: written before each observation is handed over, read when it starts."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple, Optional

import numpy as np
import rospy

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.msg import PlanarState
from embodied_active_learning.pipeline.exploration import ExplorationRun
from embodied_active_learning.ros.conversions import state_arrays, state_message
from embodied_active_learning.session.paths import SessionPaths
from embodied_active_learning.session.planner_state import PlannerState, load_planner_state, save_planner_state


class Recalled(NamedTuple):
    """A run as it was before an observation, and that observation."""

    run: ExplorationRun
    state: PlanarState  # where it was taken; a simulated arm can return to this stamp
    is_stored: bool  # whether the trainer has stored it


class PlannerResume:
    """What a planner that is started again needs in order to go on as if it were the first."""

    def __init__(self, config: Config, session: Path) -> None:
        self._config = config
        self._path = SessionPaths(session).planner

    def remember(self, run: ExplorationRun, state: PlanarState) -> None:
        """Write down a run and the state of the observation that it is about to hand over.

        Raises SessionError when the disk fails.
        """
        stamp = state.header.stamp
        pose, velocity = state_arrays(state)
        planner = PlannerState(run.step, (stamp.secs, stamp.nsecs), pose, velocity, run.state_dict())
        save_planner_state(self._path, planner)

    def recall(self, trajectory: np.ndarray) -> Optional[Recalled]:
        """What was written down last, after a trajectory (N, 3) of stored observations; None for a run that begins.

        None also, and a warning, for what is damaged or does not tell of the newest stored observation or the next.
        """
        stored = len(trajectory)
        try:
            memory = load_planner_state(self._path)
            if memory is None and not stored:
                return None
            if memory is None or memory.index not in (stored - 1, stored):
                raise CorruptFileError(f"{self._path} does not tell of observation {stored}, which is next")
            if memory.index < stored and not np.array_equal(memory.state, trajectory[-1]):
                raise CorruptFileError(
                    f"{self._path} is of another run: its state is not that of the newest observation"
                )
            run = ExplorationRun(self._config, trajectory[: memory.index])
            run.load_state_dict(memory.run)
        except CorruptFileError as error:
            rospy.logwarn("exploration goes on from what is stored, but with other random draws: %s", error)
            return None
        state = state_message(rospy.Time(*memory.stamp), memory.state, memory.velocity)
        return Recalled(run, state, memory.index < stored)
