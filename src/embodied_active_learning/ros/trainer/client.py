"""Client of the trainer's services."""

from __future__ import annotations

from pathlib import Path
from typing import Optional, Tuple

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ServiceError, SessionError
from embodied_active_learning.msg import Observation
from embodied_active_learning.pipeline.exploration import await_log_std
from embodied_active_learning.ros import names
from embodied_active_learning.ros.conversions import states_array
from embodied_active_learning.ros.runtime.services import RetryingService, trigger_if_advertised
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

    @property
    def steps(self) -> int:
        """Number of exploration steps of the run, fewer than configured once the trainer has ended it early."""
        return self._config.exploration.steps

    def trajectory(self) -> Tuple[np.ndarray, Path]:
        """Return the states (N, 3) [m, m, rad] of the stored observations, and the session's folder."""
        response = self._trajectory.call(GetTrajectoryRequest())
        self._config = self._config.with_steps(response.steps)
        return states_array(response.states), Path(response.session)

    def observe(self, observation: Observation) -> None:
        """Store an observation; on return it is on the trainer's disk.

        Raises:
            ServiceError: The trainer rejected the observation.
        """
        response = self._observe.call(ObserveRequest(observation))
        if not response.success:
            raise ServiceError(f"observation {observation.index} was not stored: {response.message}")

    def log_std(self, states: np.ndarray, observations: int) -> Optional[np.ndarray]:
        """Return the log standard deviation (S,) at states (S, 3) [m, m, rad]; None before anything is learned.

        Waits for the model that is awaited after this many observations.

        Raises:
            ServiceError: The trainer rejected the states.
        """
        request, made = EvaluateEntropyRequest(states=np.asarray(states).ravel().tolist()), 0

        def query(min_updates: int) -> Tuple[Optional[np.ndarray], bool]:
            nonlocal made
            request.min_updates = min_updates
            response = self._entropy.call(request)
            if not response.success:
                raise ServiceError(f"the trainer returned no entropy: {response.message}")
            made = response.updates
            self._config = self._config.with_steps(response.steps)
            return np.array(response.log_std) if response.learned else None, response.ready

        with log_wait(lambda: f"the trainer: update {made} of {request.min_updates}"):
            return await_log_std(lambda: self._config, observations, query)


def save_model() -> None:
    """Make a running trainer, if there is one, store its current model.

    Raises:
        ServiceError: The trainer does not respond.
        SessionError: It cannot store the model.
    """
    response = trigger_if_advertised(names.TRAINER_SAVE)
    if response is not None and not response.success:
        raise SessionError(f"the trainer could not save its model: {response.message}")
