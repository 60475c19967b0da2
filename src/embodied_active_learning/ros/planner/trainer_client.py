"""The planner's side of the trainer."""

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
    """Asks the trainer, waits for it as long as it takes, and says so meanwhile."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._observe = RetryingService(names.TRAINER_OBSERVE, Observe)
        self._entropy = RetryingService(names.TRAINER_ENTROPY, EvaluateEntropy)
        self._trajectory = RetryingService(names.TRAINER_TRAJECTORY, GetTrajectory)

    def trajectory(self) -> Tuple[np.ndarray, Path]:
        """States (N, 3) of what is stored, SI units, and the session's folder."""
        answer = self._trajectory.call(GetTrajectoryRequest())
        return states_array(answer.states), Path(answer.session)

    def observe(self, observation: Observation) -> None:
        """Hand over one observation; when this returns it is stored for good. Raises the trainer's refusal."""
        answer = self._observe.call(ObserveRequest(observation))
        if not answer.success:
            raise EmbodiedActiveLearningError(f"observation {observation.index} was not stored: {answer.message}")

    def log_std(self, states: np.ndarray, observations: int) -> Optional[np.ndarray]:
        """Log standard deviation (S,) at states (S, 3) in SI units; None while nothing is learned.

        Waits until the trainer is at most max_lag updates behind what is to be awaited with so many observations.
        """
        awaited = self._config.updates_awaited(observations)
        if awaited == 0:
            return None  # also where the trainer was quick, so that a run can be repeated
        updates = max(0, awaited - self._config.training.max_lag)
        request = EvaluateEntropyRequest(updates, np.asarray(states).ravel().tolist())
        made = 0
        with log_wait(lambda: f"the trainer: update {made} of {updates}"):
            while True:
                answer = self._entropy.call(request)
                if not answer.success:
                    raise EmbodiedActiveLearningError(f"the trainer gave no entropy: {answer.message}")
                if answer.ready:
                    return np.array(answer.log_std) if answer.learned else None
                made = answer.updates
