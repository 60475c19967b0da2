"""Checkpoints of a training run: written once per state, restored at the start and after a divergence."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any, Mapping, Optional, Tuple

from embodied_active_learning.errors import CorruptFileError, DivergenceError
from embodied_active_learning.model.learner import Learner
from embodied_active_learning.model.learner_state import LearnerState
from embodied_active_learning.session.checkpoints import Checkpoint, load_latest, save_checkpoint
from embodied_active_learning.session.paths import SessionPaths

LOG = logging.getLogger(__name__)
ROLLBACKS = 3  # at one update, before training fails


class RunCheckpoints:
    """The checkpoints of a run, for its training thread."""

    def __init__(self, paths: SessionPaths, kept: int) -> None:
        """paths: of the session. kept: number of checkpoints to keep."""
        self._paths = paths
        self._kept = kept
        self._newest: Optional[Tuple[Tuple[int, ...], Path]] = None  # content, path
        self._initial: Optional[LearnerState] = None
        self._diverged_at, self._rollbacks_there = 0, 0

    def load(self, observations: int) -> Optional[Checkpoint]:
        """Return the newest intact checkpoint, or None without checkpoints.

        Args:
            observations: Number of observations that are stored.

        Raises:
            CorruptFileError: All checkpoints are damaged, or observations that the newest was trained on are missing.
        """
        checkpoint = load_latest(self._paths.checkpoints)
        if checkpoint is None:
            return None
        for reason in checkpoint.refused:
            LOG.warning("checkpoint skipped, using an older one: %s", reason)
        if checkpoint.observations > observations:
            raise CorruptFileError(
                f"observations missing: {self._paths.observations} holds {observations}, but {checkpoint.path.name} "
                f"was trained on {checkpoint.observations}; restore the file or start a new session"
            )
        return checkpoint

    def keep_initial(self, learner: Learner) -> None:
        """Keep the state of a learner without updates, to return to it before the first checkpoint."""
        self._initial = learner.state_dict()

    def write(self, learner: Learner, refreshed: int, observations: int, counters: Mapping[str, Any]) -> Path:
        """Write a checkpoint of the learner, unless this state has one, and return its path.

        Args:
            learner: The run's learner, between two updates.
            refreshed: Number of updates of the newest replica.
            observations: Number of observations stored.
            counters: Further state of the run, as plain data, by name.

        Raises:
            DivergenceError: A weight is not finite; earlier checkpoints are kept.
            SessionError: The file cannot be written.
        """
        content = learner.updates, learner.skipped, learner.rollbacks, refreshed, observations
        if self._newest is not None:
            stored, path = self._newest
            if stored == content and path.exists():
                return path
        state = learner.state_dict()
        invalid = state.non_finite()
        if invalid is not None:
            raise DivergenceError(
                f"training diverged: {invalid} is not finite at update {learner.updates}; lower training/learning_rate"
            )
        path = save_checkpoint(
            self._paths.checkpoints,
            learner.updates,
            observations,
            state.tensors,
            {**state.counters, **counters},
            self._kept,
        )
        self._newest = content, path
        self._initial = None
        return path

    def last_good(self, updates: int, error: DivergenceError) -> LearnerState:
        """Return the state to continue from after a divergence: of the newest checkpoint, or the initial one.

        Args:
            updates: Number of updates of the diverged model.
            error: The divergence.

        Raises:
            DivergenceError: There is no such state, or ROLLBACKS rollbacks have not brought the run further.
        """
        progressed = updates > self._diverged_at
        self._diverged_at = max(self._diverged_at, updates)
        self._rollbacks_there = 1 if progressed else self._rollbacks_there + 1
        if self._rollbacks_there > ROLLBACKS:
            raise DivergenceError(f"{error} ({ROLLBACKS} rollbacks to the last good checkpoint have not helped)")
        checkpoint = load_latest(self._paths.checkpoints)
        if checkpoint is not None:
            return LearnerState(checkpoint.tensors, checkpoint.counters)
        if self._initial is None:
            raise DivergenceError(f"{error} (no checkpoint to return to)")
        return self._initial
