"""Early stop of a training run: regular checks whether its objects are learned, and the resulting number of steps."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Dict, Mapping, Optional

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.model.learner import Learner
from embodied_active_learning.model.metrics import Evaluation
from embodied_active_learning.model.trained_model import TrainedModel
from embodied_active_learning.objects.clustering import find_objects, warn_about_bandwidth
from embodied_active_learning.objects.stability import Measurement, StopCheck, StoppingCriterion, unexplained
from embodied_active_learning.session.observations import Observations

CHECK_EVERY = 50
"""Observations between two checks."""
_LATENTS, _SAMPLES = 3, 250
"""Fewer than for fingerprints, because a check must take little time; centres differ by a few millimetres."""


class EarlyStop:
    """The stopping criterion of a run, and the number of steps after which the run ends."""

    def __init__(self, config: Config) -> None:
        warn_about_bandwidth(config.fingerprint)
        self._config = config
        self._criterion = StoppingCriterion()
        self.steps: Optional[int] = None
        """Number of steps of the run; None until it is decided."""
        self.newest: Optional[StopCheck] = None
        """The newest check since the start of the program."""

    @property
    def period(self) -> int:
        """Number of updates between two checks."""
        return CHECK_EVERY * self._config.training.updates_per_observation

    def check(self, learner: Learner, evaluation: Evaluation, stored: Observations) -> StopCheck:
        """Check the model after an update, and set `steps` if the run may end.

        The check depends on the observations that the model has learned from, not on those that came since: a run in
        lock-step ends after the same number of steps each time.

        Args:
            learner: The run's learner, between two updates.
            evaluation: The evaluation after this update.
            stored: All stored observations.
        """
        model = TrainedModel(self._config, dict(learner.network.state_dict()))
        check = self._criterion.add(measure(self._config, model, evaluation, learner.loss_weights.coverage, stored))
        if check.stopped:
            # A planner in lock-step receives this model, and with it the decision, after that many observations.
            awaiting = self._config.update_plan.observations_awaiting(evaluation.update)
            self.steps = min(self._config.exploration.steps, max(awaiting, len(stored.stamps)))
        self.newest = check
        return check

    def state_dict(self) -> Dict[str, Any]:
        """Return the state as plain data."""
        return {"steps": self.steps, **self._criterion.state_dict()}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore state_dict(). Raises CorruptFileError."""
        steps = state.get("steps") if isinstance(state, Mapping) else ""
        if not (steps is None or (isinstance(steps, int) and self._config.training.first_update_at <= steps)):
            raise CorruptFileError(f"invalid state of the stopping criterion: steps is {steps!r}")
        self._criterion.load_state_dict(state)
        self.steps = None if steps is None else min(steps, self._config.exploration.steps)


def measure(
    config: Config, model: TrainedModel, evaluation: Evaluation, coverage: float, stored: Observations
) -> Measurement:
    """Return what the stopping criterion needs to know about a model.

    Args:
        config: The run's configuration.
        model: The model after an update.
        evaluation: The evaluation of this model.
        coverage: Workspace coverage k after this update.
        stored: Stored observations, at least those that the model has learned from.
    """
    count = evaluation.observations
    states, images = stored.raw_states[:count], stored.images[:count]
    settings = replace(config.fingerprint, latents=_LATENTS, samples=_SAMPLES)
    reduced = replace(config, fingerprint=settings)
    found = find_objects(model, states, images, reduced, config.exploration.seed, blank=False)
    objects = [cluster.centre[:2] for cluster in (*found.clusters, *found.unreachable)]
    centres: np.ndarray = np.array(objects, dtype=np.float64).reshape(-1, 2)
    things = unexplained(_within_workspace(found.visible.things, config), centres, settings.merge_distance)
    return Measurement(
        update=evaluation.update,
        observations=count,
        centres=centres,
        undiscovered=len(things),
        contrast=found.contrast,
        latent_contribution=evaluation.errors.latent_contribution,
        coverage=coverage,
    )


def _within_workspace(points: np.ndarray, config: Config) -> np.ndarray:
    """Return those of the points (K, 2) [m] over which the camera can be moved."""
    lower, upper = config.workspace.box().lower[:2], config.workspace.box().upper[:2]
    return points[np.all((points >= lower) & (points <= upper), axis=1)]
