"""Output of each exploration step: messages, rviz displays and a row of exploration.csv."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rospy

from embodied_active_learning.config import Config
from embodied_active_learning.msg import PlanarState, TargetDistribution
from embodied_active_learning.pipeline.exploration import ExplorationRun, StepMetrics, exploration_row
from embodied_active_learning.ros import names
from embodied_active_learning.ros.conversions import state_arrays
from embodied_active_learning.ros.rviz.exploration import RvizExploration
from embodied_active_learning.session.paths import SessionPaths
from embodied_active_learning.session.tables import COLUMNS, Table, read_table

TABLE = "exploration"


class ExplorationOutput:
    """Publishes and records the steps of a run."""

    def __init__(self, config: Config, session: Path, steps_done: int) -> None:
        """Open the session's table, and remove rows after step `steps_done`."""
        self._publisher = rospy.Publisher(names.TARGET_DISTRIBUTION, TargetDistribution, queue_size=10, latch=True)
        self._rviz = RvizExploration(config)
        self._table = Table(SessionPaths(session).table(TABLE), COLUMNS[TABLE])
        self._table.truncate_after("step", steps_done)
        rows = read_table(self._table.path, self._table.columns)
        self.last_step = int(rows["step"][-1]) if len(rows["step"]) else 0
        """The newest step in the table."""
        self.effort = float(rows["effort"][-1]) if len(rows["effort"]) else 0.0
        """Effort after that step, see StepMetrics."""

    def report(self, state: PlanarState, run: ExplorationRun, metrics: StepMetrics, last: bool) -> None:
        """Publish the step that ended in a state; append its row unless it was written before a resume.

        last: Whether it is the last step of the run.
        """
        if metrics.step > self.last_step:
            stamp, (pose, _) = state.header.stamp.to_sec(), state_arrays(state)
            self._table.append(exploration_row(stamp, pose, metrics))
            self.last_step = metrics.step
        self._publisher.publish(_message(state, run, metrics))
        self._rviz.show_step(state.header.stamp, run, metrics, last=last)

    def report_plan(self, stamp: rospy.Time, states: np.ndarray) -> None:
        """Publish the planned states (H, 3) [m, m, rad] of the next command."""
        self._rviz.show_plan(stamp, states)

    def close(self) -> None:
        """Close the table."""
        self._table.close()


def _message(state: PlanarState, run: ExplorationRun, metrics: StepMetrics) -> TargetDistribution:
    return TargetDistribution(
        header=state.header,
        step=metrics.step,
        states=run.sample_states.ravel().tolist(),
        target=metrics.target.tolist(),
        time_average=metrics.time_average.tolist(),
        coverage=metrics.coverage,
        ergodic_measure=metrics.ergodic_measure,
        distance=metrics.distance,
        turning=metrics.turning,
        effort=metrics.effort,
    )
