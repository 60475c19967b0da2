"""The trainer's services."""

from __future__ import annotations

from typing import Any, Callable

from std_srvs.srv import Trigger, TriggerResponse

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.pipeline.training import TrainingRun
from embodied_active_learning.ros import names
from embodied_active_learning.ros.conversions import image_array, state_arrays, states_array
from embodied_active_learning.ros.runtime.services import advertise_service
from embodied_active_learning.srv import (
    Encode,
    EncodeResponse,
    EvaluateEntropy,
    EvaluateEntropyResponse,
    GetTrajectory,
    GetTrajectoryResponse,
    Observe,
    ObserveResponse,
)

MAX_IMAGES = 256  # in one call of encode
MAX_STATES = 100000  # in one call of entropy


class TrainerServices:
    """Offers a TrainingRun's observations, model and checkpoints to other nodes."""

    def __init__(self, run: TrainingRun, config: Config, on_observation: Callable[[], None]) -> None:
        """Offer the services.

        Args:
            run: The training run.
            config: The configuration.
            on_observation: Called after each stored observation.
        """
        self._run = run
        self._camera = config.camera
        self._on_observation = on_observation
        advertise_service(names.TRAINER_OBSERVE, Observe, self._observe)
        advertise_service(names.TRAINER_ENTROPY, EvaluateEntropy, self._entropy)
        advertise_service(names.TRAINER_ENCODE, Encode, self._encode)
        advertise_service(names.TRAINER_SAVE, Trigger, self._save)
        advertise_service(names.TRAINER_TRAJECTORY, GetTrajectory, self._trajectory)

    def _observe(self, request: Any) -> ObserveResponse:
        """Store an observation."""
        observation = request.observation
        image = image_array(observation.image, self._camera.height, self._camera.width)
        state, _ = state_arrays(observation.state)
        self._run.observe(observation.index, observation.header.stamp.to_sec(), state.tolist(), image)
        self._on_observation()
        return ObserveResponse(True, "", self._run.observations)

    def _entropy(self, request: Any) -> EvaluateEntropyResponse:
        """Return the log standard deviation at sample states."""
        states = states_array(request.states)
        if len(states) > MAX_STATES:
            raise ObservationError(f"too many states: {len(states)}; send at most {MAX_STATES} in one call")
        log_std, updates, ready = self._run.log_std(states, request.min_updates)
        return EvaluateEntropyResponse(
            success=True,
            ready=ready,
            learned=log_std is not None,
            log_std=[] if log_std is None else log_std.tolist(),
            updates=updates,
            observations=self._run.observations,
            steps=self._run.config.exploration.steps,
        )

    def _encode(self, request: Any) -> EncodeResponse:
        """Return the latent distributions of images."""
        count = max(len(request.images), len(request.states))
        if count > MAX_IMAGES:
            raise ObservationError(f"too many images or states: {count}; send at most {MAX_IMAGES} in one call")
        images = [image_array(image, self._camera.height, self._camera.width) for image in request.images]
        states = states_array([value for state in request.states for value in state_arrays(state)[0]])
        means, stds, updates = self._run.encode(list(states), images)
        return EncodeResponse(True, "", means.shape[1], means.ravel().tolist(), stds.ravel().tolist(), updates)

    def _save(self, _request: Any) -> TriggerResponse:
        """Write a checkpoint."""
        return TriggerResponse(True, str(self._run.save()))

    def _trajectory(self, _request: Any) -> GetTrajectoryResponse:
        """Return the states of all stored observations."""
        states = self._run.trajectory.ravel().tolist()
        steps = self._run.config.exploration.steps
        return GetTrajectoryResponse(states, self._run.updates, steps, str(self._run.folder))
