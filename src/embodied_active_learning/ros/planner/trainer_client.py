"""Client of the trainer's services."""

from __future__ import annotations

from pathlib import Path
from typing import Optional, Tuple

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.errors import EmbodiedActiveLearningError
from embodied_active_learning.msg import Observation
from embodied_active_learning.ros import names
from embodied_active_learning.ros.conversions import states_array
from embodied_active_learning.ros.runtime.services import RetryingService
from embodied_active_learning.ros.runtime.wait_log import log_wait
from embodied_active_learning.srv import (
    EvaluateEntropy,
    EvaluateEntropyRequest,
    GetTrajectory,
    GetTrajectoryRequest,
    Observe,
    ObserveRequest,
)


class TrainerClient:
    """Calls the trainer, and retries without a timeout while it does not respond; the wait is logged."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._observe = RetryingService(names.TRAINER_OBSERVE, Observe)
        self._entropy = RetryingService(names.TRAINER_ENTROPY, EvaluateEntropy)
        self._trajectory = RetryingService(names.TRAINER_TRAJECTORY, GetTrajectory)

    def trajectory(self) -> Tuple[np.ndarray, Path]:
        """Return the states (N, 3) [m, m, rad] of the stored observations, and the session's folder."""
        response = self._trajectory.call(GetTrajectoryRequest())
        return states_array(response.states), Path(response.session)

    def observe(self, observation: Observation) -> None:
        """Store an observation; on return it is on the trainer's disk.

        Raises:
            EmbodiedActiveLearningError: the trainer refused the observation.
        """
        response = self._observe.call(ObserveRequest(observation))
        if not response.success:
            raise EmbodiedActiveLearningError(f"observation {observation.index} was not stored: {response.message}")

    def log_std(self, states: np.ndarray, observations: int) -> Optional[np.ndarray]:
        """Return the log standard deviation (S,) at states (S, 3) [m, m, rad]; None before anything is learned.

        Waits until the trainer is at most `training/max_lag` updates behind those due for this many observations.

        Raises:
            EmbodiedActiveLearningError: the trainer refused the states.
        """
        awaited = self._config.updates_awaited(observations)
        if awaited == 0:
            return None  # even if the trainer is ahead, so that runs are reproducible
        updates = max(0, awaited - self._config.training.max_lag)
        request = EvaluateEntropyRequest(updates, np.asarray(states).ravel().tolist())
        made = 0
        with log_wait(lambda: f"the trainer: update {made} of {updates}"):
            while True:
                response = self._entropy.call(request)
                if not response.success:
                    raise EmbodiedActiveLearningError(f"the trainer returned no entropy: {response.message}")
                if response.ready:
                    return np.array(response.log_std) if response.learned else None
                made = response.updates
