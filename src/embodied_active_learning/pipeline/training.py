"""A training run without ROS: owns session, observations and learner. Paper, Alg. 1, lines 3, 4 and 12 to 14."""

from __future__ import annotations

import dataclasses
import logging
import threading
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Callable, Mapping, Optional, Sequence, Tuple

import numpy as np
import torch

from embodied_active_learning.config import Config
from embodied_active_learning.distributed.pool import WorkerPool
from embodied_active_learning.errors import (
    ConfigError,
    CorruptFileError,
    DivergenceError,
    ObservationError,
    SessionError,
)
from embodied_active_learning.model.learner import Learner, UpdateReport
from embodied_active_learning.model.learner_state import LearnerState, network_weights
from embodied_active_learning.model.loss import LossFunction
from embodied_active_learning.objects.stability import StopCheck
from embodied_active_learning.pipeline.run_checkpoints import RunCheckpoints
from embodied_active_learning.pipeline.stopping import EarlyStop
from embodied_active_learning.session.atomic import remove_file
from embodied_active_learning.session.checkpoints import save_model
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.tables import Table

LOG = logging.getLogger(__name__)


class TrainingRun:
    """Stores observations, makes the updates that are due, and serves queries from a replica of the model.

    One thread calls train(); any other may call observe(), log_std(), encode(), save() and stop() meanwhile.
    """

    def __init__(self, config: Config, address: str = "127.0.0.1") -> None:
        """Create or resume the configured session. Workers, if there are any, join at an address of this computer.

        Raises EmbodiedActiveLearningError if that is not possible.
        """
        self._config = config
        self._workspace = config.workspace.box()
        with ExitStack() as opened:  # releases the session's lock if a part of it is damaged
            self._session = opened.enter_context(Session.open_for_writing(config))
            self._store = opened.enter_context(self._session.open_observations())
            self._learner = Learner(config, self._store, config.exploration.seed)
            self._changed = threading.Condition()
            self._stop = threading.Event()
            self._save_requested = False
            self._saved: Optional[Path] = None
            self._checkpoints = RunCheckpoints(self._session.paths, config.training.checkpoints_kept)
            self._complete = False
            self.latent_contribution = float("nan")
            """Share of the reconstruction error that the latent removes, at the newest evaluation; NaN before it."""
            self._early_stop = EarlyStop(config) if config.may_stop_early else None
            self._restore()
            self._refreshed = self._learner.replicas.updates  # updates of the newest replica
            several = config.training.trainers > 1
            used = {"training": True, "evaluation": True, "stopping": config.may_stop_early, "rounds": several}
            self._tables = {name: self._open_table(name) for name in used if used[name]}
            self.pool = WorkerPool(config, self._store, address) if several else None
            opened.pop_all()

    @property
    def folder(self) -> Path:
        """The session's folder."""
        return self._session.paths.path

    @property
    def loss(self) -> LossFunction:
        """The implementation of the loss on this machine."""
        return self._learner.loss

    @property
    def device(self) -> torch.device:
        """The device that the model is trained on."""
        return self._learner.device

    @property
    def observations(self) -> int:
        """Number of observations stored."""
        return len(self._store)

    @property
    def updates(self) -> int:
        """Number of updates made."""
        return self._learner.updates

    @property
    def skipped(self) -> int:
        """Number of batches skipped because their loss or gradient was not finite, or their loss too large."""
        return self._learner.skipped

    @property
    def rollbacks(self) -> int:
        """Number of rollbacks to the last good checkpoint."""
        return self._learner.rollbacks

    @property
    def config(self) -> Config:
        """The run's configuration, with fewer steps once the stopping criterion has ended the exploration."""
        return self._config

    @property
    def stop_check(self) -> Optional[StopCheck]:
        """The newest check of the stopping criterion; None before the first, and if the number of steps is fixed."""
        return None if self._early_stop is None else self._early_stop.newest

    @property
    def updates_due(self) -> int:
        """Number of updates that the stored observations call for."""
        return self._config.update_plan.due(self.observations)

    @property
    def finished(self) -> bool:
        """Whether all updates are made and the final model, if there were any updates, is written."""
        return self._complete

    @property
    def trajectory(self) -> np.ndarray:
        """States (N, 3) of all observations, SI units."""
        return self._store.raw_states

    def observe(self, index: int, stamp: float, state: Sequence[float], image: np.ndarray) -> None:
        """Store an observation; one that is stored already is ignored.

        Args:
            index: Number of the observation, from 0.
            stamp: Time of the image [s].
            state: (3,) SI units.
            image: (H, W, 3) uint8.

        Raises:
            ObservationError: State or image do not fit the model.
            SessionError: It cannot be written.
        """
        self._store.append(index, stamp, state, image)
        self._wake()

    def train(self, on_update: Callable[[UpdateReport], None], on_finish: Callable[[], None] = lambda: None) -> None:
        """Make updates as they become due until stop() is called, and write a checkpoint at the end.

        Args:
            on_update: Called after each update.
            on_finish: Called once, when the final model is written.

        Raises:
            DivergenceError: The model still diverges after several rollbacks to the last good checkpoint.
            SessionError: A file cannot be written.
        """
        while not self._stop.is_set():
            try:
                self._advance(on_update, on_finish)
            except DivergenceError as error:
                self._rollback(error)
        try:
            self._checkpoint()
        except DivergenceError as error:  # found only now; the last good checkpoint is kept
            self._rollback(error)

    def stop(self) -> None:
        """Request train() to write a checkpoint and return; any thread may call this."""
        self._stop.set()
        self._wake()

    def log_std(
        self, states: np.ndarray, min_updates: int, timeout: float = 1.0
    ) -> Tuple[Optional[np.ndarray], int, bool]:
        """Return the log std predicted at states, given the newest observation's latent. Paper, Eq. 29.

        Args:
            states: (S, 3) SI units.
            min_updates: Wait for a model with this number of updates (see Replicas.conditional_log_std).
            timeout: Of the wait [s].

        Returns:
            Log std (S,), or None before the first update or after a timeout; the number of updates of the model; and
            whether it has min_updates.
        """
        ready = self._wait_for_updates(min_updates, timeout)
        replicas = self._learner.replicas
        count = self.observations
        if not ready or replicas.updates == 0 or count == 0:
            return None, replicas.updates, ready
        newest = self._store.states[count - 1], self._store.images[count - 1]
        log_std, updates = replicas.conditional_log_std(self._workspace.normalise(states), *newest, min_updates)
        return log_std, updates, ready

    def encode(self, states: Sequence[np.ndarray], images: Sequence[np.ndarray]) -> Tuple[np.ndarray, np.ndarray, int]:
        """Return mean and std (N, L) of the latents, and the number of updates of the model.

        Args:
            states: N states (3,), SI units.
            images: N images (H, W, 3) uint8.

        Raises:
            ObservationError: The numbers differ or are 0, or the images do not fit the model.
        """
        if not images or len(images) != len(states):
            raise ObservationError(f"{len(images)} images and {len(states)} states: give the same number, at least one")
        return self._learner.replicas.encode(self._workspace.normalise(np.asarray(states)), np.stack(images))

    def save(self, timeout: float = 60.0) -> Path:
        """Request a checkpoint from the training thread; return its path. Raises SessionError after a timeout [s]."""
        with self._changed:
            self._save_requested, self._saved = True, None
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._saved is not None, timeout)
            if self._saved is None:
                raise SessionError(
                    f"checkpoint timeout: none written within {timeout:g} s because the disk or the processor is "
                    "overloaded, or training has ended; see /diagnostics and retry"
                )
            return self._saved

    def close(self) -> None:
        """Drop the workers, close the session's files and release its lock."""
        if self.pool is not None:
            self.pool.close()
        for table in self._tables.values():
            table.close()
        self._store.close()
        self._session.close()

    def _wake(self) -> None:
        """Wake all threads that wait for a change."""
        with self._changed:
            self._changed.notify_all()

    def _open_table(self, name: str) -> Table:
        """Open a table and drop the rows of updates after the checkpoint."""
        table = self._session.open_table(name)
        table.truncate_after("update", self._learner.updates)
        return table

    def _restore(self) -> None:
        """Continue from the newest checkpoint, if there is one."""
        checkpoint = self._checkpoints.load(self.observations)
        if checkpoint is None:
            self._checkpoints.keep_initial(self._learner)
            return
        try:
            self._learner.load_state_dict(LearnerState(checkpoint.tensors, checkpoint.counters))
            self._restore_early_stop(checkpoint.counters)
        except (ConfigError, CorruptFileError) as error:
            raise type(error)(f"{checkpoint.path}: {error}") from error
        remove_file(self._session.paths.model)  # outdated as soon as training continues

    def _restore_early_stop(self, counters: Mapping[str, Any]) -> None:
        """Restore the state of the stopping criterion from the counters of a checkpoint, which may have none."""
        if self._early_stop is not None:
            self._early_stop = EarlyStop(self._session.config)
            if "early_stop" in counters:
                self._early_stop.load_state_dict(counters["early_stop"])
            self._end_after(self._early_stop.steps)

    def _advance(self, on_update: Callable[[UpdateReport], None], on_finish: Callable[[], None]) -> None:
        """Make an update, finish the run or wait, whichever is due; then write a checkpoint if requested."""
        if self.updates < self.updates_due:
            before = self.updates
            if self.pool is None:
                self._make_update(on_update, before + 1)
            else:
                self._make_round(self.pool, on_update)
            self._after_updates(before)
        elif self._is_complete():
            self._finish()
            on_finish()
        else:
            self._wait_for_work()
        self._save_if_requested()

    def _make_update(self, on_update: Callable[[UpdateReport], None], end: int, trainers: int = 1) -> None:
        """Make an update that is reported as number `end` at most: in a round, others make part of the updates."""
        report = self._learner.update(trainers)
        report = dataclasses.replace(report, update=min(report.update, end))
        self._tables["training"].append(report)
        on_update(report)

    def _make_round(self, pool: WorkerPool, on_update: Callable[[UpdateReport], None]) -> None:
        """Make updates together with the workers until the round ends, a worker fails or stop() is called."""
        first, size = self.updates, self._config.update_plan.per_refresh
        end = min(first - first % size + size, self._config.update_plan.total)
        made = pool.make_round(
            self._learner, end, self._stop, lambda trainers: self._make_update(on_update, end, trainers)
        )
        if self.updates < end:  # others have not made theirs, and this trainer's have now other numbers
            self._tables["training"].truncate_after("update", self.updates)
        self._tables["rounds"].append(made)

    def _after_updates(self, before: int) -> None:
        """Evaluate, refresh a replica and write a checkpoint if that became due after update number `before`."""
        stopped = self._evaluate(before)
        if self._passed(self._config.update_plan.per_refresh, before):
            self._learner.refresh_async(self._wake)
            self._refreshed = self.updates
        if self._passed(self._config.training.checkpoint_every, before) or stopped:
            self._checkpoint()  # after the refresh, because it stores which model serves queries

    def _passed(self, period: int, before: int) -> bool:
        """Return whether a multiple of a period has been reached after update number `before`."""
        return self.updates // period > before // period

    def _evaluate(self, before: int) -> bool:
        """Evaluate the model if that became due after update number `before`.

        Return whether this ends the exploration.
        """
        early_stop = self._early_stop
        to_check = early_stop is not None and early_stop.steps is None and self._passed(early_stop.period, before)
        every, planned = self._config.training.evaluate_every, self._config.update_plan.total
        to_record = self._passed(every, before) or self.updates == planned
        if not to_check and not to_record:
            return False
        evaluation = self._learner.evaluate()
        self.latent_contribution = evaluation.errors.latent_contribution
        if to_record:
            self._tables["evaluation"].append(evaluation)
        if early_stop is None or not to_check:
            return False
        check = early_stop.check(self._learner, evaluation, self._store.snapshot())
        self._tables["stopping"].append(check.row)
        if check.stopped:
            self._end_after(early_stop.steps)
            LOG.info("%s: the exploration ends after %d steps", check.reason, self._config.exploration.steps)
        return check.stopped

    def _end_after(self, steps: Optional[int]) -> None:
        """End the run after a number of steps, unless it is None."""
        if steps is not None:
            self._config = self._config.with_steps(steps)
            self._learner.end_after(steps)

    def _rollback(self, error: DivergenceError) -> None:
        """Continue from the last good model with other batches. Raises the error after ROLLBACKS attempts."""
        good = self._checkpoints.last_good(self.updates, error)
        self._learner.rollback(good)
        self._refreshed = self._learner.replicas.updates
        self._restore_early_stop(good.counters)
        for table in self._tables.values():
            table.truncate_after("update", self.updates)
        LOG.warning("%s; rollback to the model of update %d", error, self.updates)

    def _wait_for_work(self) -> None:
        """Publish the newest model to the replicas, then wait for work."""
        if self._refreshed != self.updates:
            self._learner.refresh_async(self._wake)
            self._refreshed = self.updates
        self._learner.join()
        with self._changed:
            self._changed.wait_for(lambda: self._stop.is_set() or self._save_requested or self._has_work())

    def _has_work(self) -> bool:
        return self.updates < self.updates_due or self._is_complete()

    def _is_complete(self) -> bool:
        """Whether all observations are stored and the final model is not written yet."""
        return not self._complete and self.observations >= self._config.exploration.steps

    def _wait_for_updates(self, count: int, timeout: float) -> bool:
        with self._changed:
            return self._changed.wait_for(lambda: self._learner.replicas.updates >= count, timeout)

    def _finish(self) -> None:
        self._checkpoint()
        if self.updates:
            tensors = self._learner.state_dict().tensors
            facts = {"updates": self.updates, "observations": self.observations}
            save_model(self._session.paths.model, network_weights(tensors), facts)
        self._complete = True

    def _save_if_requested(self) -> None:
        if self._save_requested:
            path = self._checkpoint()
            with self._changed:
                self._save_requested, self._saved = False, path
                self._changed.notify_all()

    def _checkpoint(self) -> Path:
        """Write a checkpoint of the current state, unless it exists already, and return its path."""
        more = {} if self._early_stop is None else {"early_stop": self._early_stop.state_dict()}
        return self._checkpoints.write(self._learner, self._refreshed, self.observations, more)
