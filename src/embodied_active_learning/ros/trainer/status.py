"""Training progress on /training_status and /diagnostics."""

from __future__ import annotations

import threading
import time
from typing import Optional

import rospy
from visualization_msgs.msg import MarkerArray

from embodied_active_learning.config import Config
from embodied_active_learning.distributed.remote_worker import WorkerStatus
from embodied_active_learning.errors import SessionError
from embodied_active_learning.model.learner import UpdateReport
from embodied_active_learning.msg import TrainingStatus
from embodied_active_learning.objects.stability import StopCheck
from embodied_active_learning.pipeline.training import TrainingRun
from embodied_active_learning.ros import names
from embodied_active_learning.ros.runtime.diagnostics import ERROR, OK, WARN, Health, Rate, report_health, rounded
from embodied_active_learning.ros.runtime.timers import WallTimer
from embodied_active_learning.ros.rviz.clusters import cluster_markers
from embodied_active_learning.session.disk import check_space, folder_size, free_bytes

MIN_PERIOD = 0.1
"""Wall seconds between two messages while updates are made ..."""
MAX_PERIOD = 1.0
"""... and while none is made."""
_TERMS = ("loss", "reconstruction", "conditional_reconstruction", "kl", "beta", "gamma", "active_units")


class TrainerStatus:
    """Publishes the progress of a TrainingRun."""

    def __init__(self, run: TrainingRun, config: Config) -> None:
        self._run = run
        self._config = config
        self._report: Optional[UpdateReport] = None
        self._updates = Rate()
        self._observations = Rate()
        self._lock = threading.Lock()
        self._published: Optional[UpdateReport] = None
        self._published_at = 0.0
        self._shown: Optional[StopCheck] = None
        self.error: Optional[Exception] = None
        """Why training ended, if it failed."""
        self._publisher = rospy.Publisher(names.TRAINING_STATUS, TrainingStatus, queue_size=10, latch=True)
        self._clusters = rospy.Publisher(names.CLUSTER_MARKERS, MarkerArray, queue_size=1, latch=True)
        # In a thread of its own, so that publishing does not delay training.
        WallTimer(MIN_PERIOD, self._publish_if_due)
        report_health("trainer", self.health)

    def on_observation(self) -> None:
        """Count a stored observation."""
        self._observations.tick()

    def on_update(self, report: UpdateReport) -> None:
        """Take in the report of an update."""
        self._report = report
        self._updates.tick()

    def publish(self) -> None:
        """Publish the newest status."""
        with self._lock:  # so that messages keep their order
            report, config, check = self._report, self._run.config, self._run.stop_check
            status = TrainingStatus(
                observations=self._run.observations,
                updates=self._run.updates,
                updates_due=self._run.updates_due,
                updates_planned=config.update_plan.total,
                steps=config.exploration.steps,
                stopping="" if check is None else check.describe(),
                updates_per_second=self._updates.per_second,
                latent_size=self._config.model.latent_size,
                latent_contribution=self._run.latent_contribution,
                finished=self._run.finished,
                session=str(self._run.folder),
            )
            status.header.stamp = rospy.Time.now()
            for term in _TERMS:
                setattr(status, term, float(getattr(report, term, float("nan"))))
            self._published, self._published_at = report, time.monotonic()
            self._publisher.publish(status)
            if check is not None and check is not self._shown:
                self._shown = check
                self._clusters.publish(cluster_markers(status.header.stamp, check))

    def _publish_if_due(self) -> None:
        if self._report is not self._published or time.monotonic() >= self._published_at + MAX_PERIOD:
            self.publish()

    def health(self) -> Health:
        """Return the diagnostic status."""
        run = self._run
        values = {
            "observations": run.observations,
            "updates": run.updates,
            "updates due": run.updates_due,
            "updates per second": round(self._updates.per_second, 2),
            "stopping": "-" if run.stop_check is None else run.stop_check.describe(),
            "active units": getattr(self._report, "active_units", "-"),
            "age of the last observation [s]": rounded(self._observations.age),
            "batches skipped": run.skipped,
            "rollbacks": run.rollbacks,
        }
        workers = [] if run.pool is None else run.pool.status()
        values.update((f"worker {worker.slot}", describe(worker)) for worker in workers)
        if self.error is not None:
            return Health(ERROR, str(self.error), values)
        try:
            # The same requirement, with the same reserve, as before a run.
            check_space(run.folder, self._config, folder_size(run.folder))
            values["disk free [GB]"] = round(free_bytes(run.folder) / 1e9, 2)
        except SessionError as error:
            return Health(WARN, str(error), values)
        if run.rollbacks and not run.finished:
            message = f"training; rolled back {run.rollbacks} times because the model diverged"
            return Health(WARN, message, values)
        trainers = self._config.training.trainers
        if len(workers) + 1 < trainers and not run.finished:
            message = f"{self._activity()}; {len(workers) + 1} of {trainers} trainers: check the trainer_worker nodes"
            return Health(WARN, message, values)
        return Health(OK, self._activity(), values, idle=run.finished)

    def _activity(self) -> str:
        count, first = self._run.observations, self._config.training.first_update_at
        if self._run.finished:
            return "finished"
        if self._run.updates < self._run.updates_due:
            return "training"
        if count < first:
            return f"waiting for observation {count + 1}; training starts with number {first}"
        return f"waiting for observation {count + 1}"


def describe(worker: WorkerStatus) -> str:
    """Return the state of a worker in one line."""
    return (
        f"{worker.rounds} rounds, {worker.updates} updates, {worker.updates_per_second:.1f}/s, lag {worker.lag:.1f} s, "
        f"{worker.bytes / 1e6:.0f} MB, last seen {time.monotonic() - worker.seen:.1f} s ago"
    )
