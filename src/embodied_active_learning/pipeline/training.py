"""The learning half of the paper's Algorithm 1, without ROS: the owner of session, observations and learner."""

from __future__ import annotations

import dataclasses
import logging
import threading
from pathlib import Path
from typing import Callable, Optional, Sequence, Tuple

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ConfigError, CorruptFileError, ObservationError, SessionError
from embodied_active_learning.model.checkpoint import network_weights
from embodied_active_learning.model.learner import DivergenceError, Learner, UpdateReport
from embodied_active_learning.model.objective import Arithmetic
from embodied_active_learning.session.atomic import remove_file
from embodied_active_learning.session.checkpoints import load_latest, save_checkpoint, save_model
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.tables import Table

LOG = logging.getLogger(__name__)
ROLLBACKS = 3  # tried at one update before training is given up


class TrainingRun:
    """Stores what it is handed, makes the updates that are due, and answers questions from a snapshot of the model.

    One thread calls train(); observe(), log_std() and encode() may be called from any other meanwhile.
    """

    def __init__(self, config: Config) -> None:
        """Create the session, or go on with it. Raises SessionError and its kin."""
        self._config = config
        self._workspace = config.workspace.box()
        self._session = Session.open_for_writing(config)
        self._store = self._session.open_observations()
        self._learner = Learner(config, self._store, config.exploration.seed)
        self._changed = threading.Condition()
        self._save_asked = False
        self._saved: Optional[Path] = None
        self._checkpointed: Optional[Tuple[Tuple[int, ...], Path]] = None  # what the newest checkpoint is of, and where
        self._complete = False
        self._diverged_at, self._rollbacks_there = 0, 0
        self._restore()
        self._refreshed = self._learner.snapshots.updates  # of the model that answers, or is about to
        # What a model that diverges before the first checkpoint goes back to.
        self._beginning = None if self._learner.updates else self._learner.state()
        self._training_table = self._open_table("training")
        self._evaluation_table = self._open_table("evaluation")

    @property
    def folder(self) -> Path:
        """The session's folder."""
        return self._session.paths.path

    @property
    def arithmetic(self) -> Arithmetic:
        """How updates are computed on this machine."""
        return self._learner.arithmetic

    @property
    def observations(self) -> int:
        """Observations stored for good."""
        return len(self._store)

    @property
    def updates(self) -> int:
        """Updates made."""
        return self._learner.updates

    @property
    def skipped(self) -> int:
        """Batches left out because their loss or gradient was not finite."""
        return self._learner.skipped

    @property
    def rollbacks(self) -> int:
        """How often the last good model was gone back to."""
        return self._learner.rollbacks

    @property
    def updates_due(self) -> int:
        """Updates that the stored observations call for."""
        return self._config.updates_due(self.observations)

    @property
    def finished(self) -> bool:
        """Whether every update of the run is made and the final model, if anything was learned, is written."""
        return self._complete

    @property
    def trajectory(self) -> np.ndarray:
        """(N, 3) the states of every observation, SI units."""
        return self._store.raw_states

    def observe(self, index: int, stamp: float, state: Sequence[float], image: np.ndarray) -> None:
        """Store observation number index for good: state (3,) SI units, image (H, W, 3) uint8.

        Raises ObservationError for what the model was not built for, SessionError when it cannot be stored.
        """
        self._store.append(index, stamp, state, image)
        self.wake()

    def train(
        self, stop: threading.Event, on_update: Callable[[UpdateReport], None], on_finish: Callable[[], None]
    ) -> None:
        """Make the updates as they become due until stop is set (see wake), and leave a checkpoint behind.

        on_update is called after each update, on_finish once when the final model is written. A model that diverges is
        replaced by the last good one. Raises DivergenceError when that does not help, SessionError when the disk fails.
        """
        while not stop.is_set():
            if self._learner.updates < self.updates_due:
                try:
                    on_update(self._update())
                except DivergenceError as error:
                    self._roll_back(error)
            elif self._is_complete():
                self._finish()
                on_finish()
            else:
                self._wait_for_work(stop)
            self._save_if_asked()
        self._checkpoint()

    def wake(self) -> None:
        """Have everyone who waits for a change look again; train() at its stop event too."""
        with self._changed:
            self._changed.notify_all()

    def log_std(
        self, states: np.ndarray, min_updates: int, timeout: float = 1.0
    ) -> Tuple[Optional[np.ndarray], int, bool]:
        """Log standard deviation (S,) at states (S, 3) SI units, given the newest observation's latent.

        Waits up to timeout seconds for a model with min_updates; that before the newest answers if it has just these.
        -> (values, or None before the first update; updates of the model that answered; whether it had min_updates).
        """
        ready = self._wait_for_updates(min_updates, timeout)
        snapshots = self._learner.snapshots
        count = self.observations
        if not ready or snapshots.updates == 0 or count == 0:
            return None, snapshots.updates, ready
        newest = self._store.states[count - 1], self._store.images[count - 1]
        log_std, updates = snapshots.conditional_log_std(self._workspace.normalise(states), *newest, min_updates)
        return log_std, updates, ready

    def encode(self, states: Sequence[np.ndarray], images: Sequence[np.ndarray]) -> Tuple[np.ndarray, np.ndarray, int]:
        """Latent means and standard deviations (N, L) of N images (H, W, 3) from N states (3,), and the updates made.

        Raises ObservationError for images that the model was not built for.
        """
        if not images or len(images) != len(states):
            raise ObservationError(f"{len(images)} images and {len(states)} states: give one of each, or several")
        return self._learner.snapshots.encode(self._workspace.normalise(states), np.stack(images))

    def save(self, timeout: float = 60.0) -> Path:
        """Have the training thread write a checkpoint now -> its path. Raises SessionError when none came in time."""
        with self._changed:
            self._save_asked, self._saved = True, None
            self._changed.notify_all()
            if not self._changed.wait_for(lambda: self._saved is not None, timeout):
                raise SessionError(
                    f"no checkpoint was written within {timeout:g} s: the disk or the processor is overloaded, or "
                    "training has ended; see /diagnostics, and call again"
                )
            return self._saved

    def close(self) -> None:
        """Close the session's files and free its lock."""
        self._training_table.close()
        self._evaluation_table.close()
        self._store.close()
        self._session.close()

    def _open_table(self, name: str) -> Table:
        """A table without the rows of updates that were made after the checkpoint."""
        table = self._session.open_table(name)
        table.truncate_after("update", self._learner.updates)
        return table

    def _restore(self) -> None:
        checkpoint = load_latest(self._session.paths.checkpoints)
        if checkpoint is None:
            return
        for reason in checkpoint.refused:
            LOG.warning("checkpoint refused, an older one is used: %s", reason)
        observed = checkpoint.counters.get("observations", 0)
        if observed > self.observations:
            raise CorruptFileError(
                f"{self._session.paths.observations} holds {self.observations} observations, but there were {observed} "
                f"when {checkpoint.path.name} was written: restore them, or start a new session"
            )
        try:
            self._learner.restore(checkpoint.tensors, checkpoint.counters)
        except (ConfigError, CorruptFileError) as error:
            raise type(error)(f"{checkpoint.path}: {error}") from error
        remove_file(self._session.paths.model)  # it is older than what is learned from here on

    def _update(self) -> UpdateReport:
        report = self._learner.update()
        self._training_table.append(dataclasses.asdict(report))
        training = self._config.training
        if report.update % training.evaluate_every == 0 or report.update == self._config.updates_planned:
            self._evaluation_table.append(dataclasses.asdict(self._learner.evaluate()))
        if report.update % training.updates_per_observation == 0:
            self._learner.refresh_meanwhile(self.wake)
            self._refreshed = report.update
        if report.update % training.checkpoint_every == 0:
            self._checkpoint()  # after the refresh, because it tells which model answers
        return report

    def _roll_back(self, error: DivergenceError) -> None:
        """Go on from the last good model with other batches. Raises the error when that was tried often enough."""
        past = self.updates > self._diverged_at
        self._diverged_at = max(self._diverged_at, self.updates)
        self._rollbacks_there = 1 if past else self._rollbacks_there + 1
        if self._rollbacks_there > ROLLBACKS:
            raise DivergenceError(f"{error}; going back to the last good model has not helped {ROLLBACKS} times")
        checkpoint = load_latest(self._session.paths.checkpoints)
        good = self._beginning if checkpoint is None else (checkpoint.tensors, checkpoint.counters)
        self._learner.roll_back(*good)
        self._refreshed = self._learner.snapshots.updates
        for table in (self._training_table, self._evaluation_table):
            table.truncate_after("update", self.updates)
        LOG.warning("%s. Going on from the good model of update %d", error, self.updates)

    def _wait_for_work(self, stop: threading.Event) -> None:
        """Sleep until there is something to do; before that, let everyone see the newest model."""
        if self._refreshed != self.updates:
            self._learner.refresh_meanwhile(self.wake)
            self._refreshed = self.updates
        self._learner.settle()
        with self._changed:
            self._changed.wait_for(lambda: stop.is_set() or self._save_asked or self._has_work())

    def _has_work(self) -> bool:
        return self.updates < self.updates_due or self._is_complete()

    def _is_complete(self) -> bool:
        """Whether all is observed and, once no update is due, only the final model, if there is one, is missing."""
        return not self._complete and self.observations >= self._config.exploration.steps

    def _wait_for_updates(self, count: int, timeout: float) -> bool:
        with self._changed:
            return self._changed.wait_for(lambda: self._learner.snapshots.updates >= count, timeout)

    def _finish(self) -> None:
        self._checkpoint()
        if self.updates:
            tensors, _ = self._learner.state()
            facts = {"updates": self.updates, "observations": self.observations}
            save_model(self._session.paths.model, network_weights(tensors), facts)
        self._complete = True

    def _save_if_asked(self) -> None:
        if self._save_asked:
            path = self._checkpoint()
            with self._changed:
                self._save_asked, self._saved = False, path
                self._changed.notify_all()

    def _checkpoint(self) -> Path:
        """Have a checkpoint of what is known now -> its path. One that is there already is not written again."""
        learner = self._learner
        content = self.updates, self.skipped, self.rollbacks, self._refreshed, self.observations
        if self._checkpointed is not None:
            known, path = self._checkpointed
            if known == content and path.exists():
                return path
        tensors, counters = learner.state()
        counters["observations"] = self.observations
        kept = self._config.training.checkpoints_kept
        path = save_checkpoint(self._session.paths.checkpoints, self.updates, tensors, counters, kept)
        self._checkpointed = content, path
        self._beginning = None
        return path
