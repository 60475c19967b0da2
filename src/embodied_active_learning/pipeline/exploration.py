"""The exploration half of the paper's Algorithm 1, without robot or ROS: observe, evaluate, choose the next command."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Callable, Dict, Mapping, Optional, Tuple

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CorruptFileError, EmbodiedActiveLearningError
from embodied_active_learning.exploration.commands import Command, PoseCommand, VelocityCommand
from embodied_active_learning.exploration.ergodic_objective import (
    kl_ergodic,
    normalise,
    uniform_distribution,
)
from embodied_active_learning.exploration.explorer import Explorer
from embodied_active_learning.exploration.samples import WorkspaceSamples
from embodied_active_learning.files import short_repr
from embodied_active_learning.registry import EXPLORERS, INFORMATION_MEASURES
from embodied_active_learning.rng import resumed_seed
from embodied_active_learning.state_dict import StateDict, add_prefix, matching_arrays, select_prefix


@dataclass(frozen=True)
class StepMetrics:
    """Target, time average and metrics of one exploration step."""

    step: int
    target: np.ndarray  # (S,) h(s), sum 1
    time_average: np.ndarray  # (S,) d(s) of the visited states, sum 1
    coverage: float  # k
    ergodic_measure: float  # D_KL(h || d) [nat], without planned states
    distance: float  # path length in x and y [m]
    turning: float  # sum of the absolute changes of yaw [rad]
    effort: float  # integral of the squared normalised acceleration [1/s^3]; NaN for pose commands


def exploration_row(stamp: float, state: np.ndarray, metrics: StepMetrics) -> Dict[str, float]:
    """Return the row of exploration.csv for a step. stamp: [s]; state: (3,) [m, m, rad]."""
    x, y, theta = map(float, state)
    return {
        "step": metrics.step,
        "time": stamp,
        "x": x,
        "y": y,
        "theta": theta,
        "ergodic_measure": metrics.ergodic_measure,
        "coverage": metrics.coverage,
        "distance": metrics.distance,
        "turning": metrics.turning,
        "effort": metrics.effort,
    }


def first_command(config: Config, trajectory: np.ndarray) -> Command:
    """Return the arm to the last state of a trajectory (N, 3) [m, m, rad]; without one, hold it still for a step."""
    if len(trajectory):
        return PoseCommand.from_array(config.workspace.box().clip(trajectory[-1]))
    return VelocityCommand(0.0, 0.0, 0.0, config.exploration.step_duration)


def await_log_std(
    config: Callable[[], Config], observations: int, query: Callable[[int], Tuple[Optional[np.ndarray], bool]]
) -> Optional[np.ndarray]:
    """Query the log standard deviation until the model is the one awaited after a number of observations.

    Training is then at most `training/max_lag` updates behind those due for this many observations.

    Args:
        config: Returns the run's configuration, which has fewer steps once training has ended the exploration.
        observations: Number of observations so far.
        query: Returns the log standard deviation (S,) or None, and whether the model has the given number of updates.

    Returns:
        Log standard deviation (S,), or None before anything is learned.
    """
    awaited = config().update_plan.awaited(observations)
    if awaited == 0:
        return None  # even if training is ahead, so that runs are reproducible
    while True:
        log_std, ready = query(max(0, awaited - config().training.max_lag))
        # After an early stop, more updates are awaited.
        before, awaited = awaited, config().update_plan.awaited(observations)
        if ready and awaited == before:
            return log_std


class ExplorationRun:
    """One exploration run: samples, explorer and metrics. States and commands are in SI units."""

    def __init__(self, config: Config, trajectory: Optional[np.ndarray] = None, effort: float = 0.0) -> None:
        """Start a run, or resume one with other random draws (exact resume: `load_state_dict`).

        Args:
            config: The configuration.
            trajectory: (N, 3) [m, m, rad] states observed so far.
            effort: Effort spent so far, see StepMetrics.
        """
        self._workspace = config.workspace.box()
        visited = np.empty((0, self._workspace.size)) if trajectory is None else np.asarray(trajectory)
        seed = resumed_seed(config.exploration.seed, len(visited))
        exploration = replace(config.exploration, seed=seed)
        config = replace(config, exploration=exploration)
        self._samples = WorkspaceSamples(config, self._workspace.normalise(visited))
        self._explorer = _make_explorer(config, seed)
        self._measure = INFORMATION_MEASURES[exploration.measure]
        self._step_duration = exploration.step_duration
        self._step = len(visited)
        self._state: Optional[np.ndarray] = visited[-1] if len(visited) else None
        dx, dy, dtheta = np.diff(visited, axis=0).T
        self._distance = float(np.sum(np.hypot(dx, dy)))
        self._turning = float(np.sum(np.abs(dtheta)))
        self._effort = effort
        self._velocity = np.zeros(self._workspace.size)
        self._target = uniform_distribution(config.exploration.samples)

    @property
    def step(self) -> int:
        """Number of observations so far."""
        return self._step

    @property
    def sample_states(self) -> np.ndarray:
        """Workspace samples (S, 3) of this step [m, m, rad]."""
        return self._workspace.denormalise(self._samples.states)

    @property
    def planned_states(self) -> np.ndarray:
        """Planned states (H, 3) [m, m, rad].

        Empty, (0, 3), between `observe` and `next_command`, and for an explorer that does not plan.
        """
        return self._workspace.denormalise(self._explorer.planned_states)

    @property
    def travelled_states(self) -> np.ndarray:
        """Visited states (N, 3) [m, m, rad]."""
        return self._workspace.denormalise(self._samples.visited)

    def observe(self, state: np.ndarray, velocity: np.ndarray) -> None:
        """Add an observed state (3,) [m, m, rad] with its measured velocity (3,), and refresh the samples."""
        if self._state is not None:
            dx, dy, dtheta = state - self._state
            self._distance += float(np.hypot(dx, dy))
            self._turning += float(abs(dtheta))
        self._state = state
        self._step += 1
        normalised = self._workspace.normalise(state)
        self._samples.visit(normalised)
        self._samples.refresh()
        self._explorer.observe(normalised, velocity)

    def evaluate_step(self, log_std: Optional[np.ndarray]) -> StepMetrics:
        """Set the target from the model's log standard deviation (S,) at the samples.

        Args:
            log_std: None before anything is learned: the target is uniform.
        """
        coverage = self._samples.coverage
        visitation = self._samples.visitation
        if log_std is None:
            self._target = uniform_distribution(len(visitation))
        else:
            self._target = _checked_target(self._measure(log_std, coverage), len(visitation))
        return StepMetrics(
            step=self._step,
            target=self._target,
            time_average=normalise(visitation),
            coverage=coverage,
            ergodic_measure=kl_ergodic(self._target, visitation),
            distance=self._distance,
            turning=self._turning,
            effort=self._effort,
        )

    def next_command(self) -> Command:
        """Return the next command for the target of the last evaluate_step."""
        command = self._explorer.next_command(self._target, self._samples)
        if not isinstance(command, (VelocityCommand, PoseCommand)):
            raise EmbodiedActiveLearningError(
                f"the explorer's next_command returned {short_repr(command)}: expected a PoseCommand or VelocityCommand"
            )
        if isinstance(command, VelocityCommand):
            acceleration = (command.velocity - self._velocity) / self._workspace.scale / self._step_duration
            self._effort += float(acceleration @ acceleration) * self._step_duration
            self._velocity = command.velocity
        else:
            self._effort = float("nan")
        return command

    def set_open_places(self, places: np.ndarray) -> None:
        """Set the places (P, 2) [m] about which an identification needs more views."""
        self._explorer.set_open_places(places)

    def interrupt(self) -> None:
        """Discard plan and velocity after the arm was stopped from outside."""
        self._explorer.reset()
        self._velocity = np.zeros(self._workspace.size)

    def state_dict(self) -> StateDict:
        """Return copies of everything but the visited states that determines the rest of the run."""
        return {
            **self._own_state(),
            **add_prefix("samples", self._samples.state_dict()),
            **add_prefix("explorer", self._explorer.state_dict()),
        }

    def load_state_dict(self, state: Mapping[str, np.ndarray]) -> None:
        """Continue exactly like the run that returned this state after the same trajectory.

        Raises:
            CorruptFileError: The state is of another trajectory or configuration; discard this run then.
        """
        own = matching_arrays(state, self._own_state())
        saved_step = int(own["step"][0])
        if saved_step != self._step:
            raise CorruptFileError(f"saved state is of step {saved_step}, the stored trajectory of step {self._step}")
        self._samples.load_state_dict(select_prefix("samples", state))
        self._explorer.load_state_dict(select_prefix("explorer", state))
        self._state = own["state"] if self._step else None
        self._velocity, self._target = own["velocity"], own["target"]
        self._distance, self._turning, self._effort = own["sums"].tolist()

    def _own_state(self) -> StateDict:
        state = np.full(self._workspace.size, np.nan) if self._state is None else self._state
        return {
            "step": np.array([self._step]),
            "state": np.array(state, dtype=np.float64),
            "velocity": np.array(self._velocity, dtype=np.float64),
            "sums": np.array([self._distance, self._turning, self._effort]),
            "target": np.array(self._target, dtype=np.float64),
        }


def _checked_target(target: np.ndarray, samples: int) -> np.ndarray:
    """Return what an information measure has returned, if it is a distribution over the samples (S,)."""
    values: np.ndarray = np.asarray(target, dtype=np.float64)
    if values.shape != (samples,):
        problem = f"shape {values.shape}"
    elif not np.isfinite(values).all():
        problem = "values that are not finite"
    elif values.min() < 0.0:
        problem = "negative values"
    elif not values.any():
        problem = "only zeros"
    else:
        return values
    raise EmbodiedActiveLearningError(
        f"the information measure (exploration/measure) returned {problem}: return {samples} numbers of at least 0,"
        " one for each sample, with sum 1"
    )


def _make_explorer(config: Config, seed: int) -> Explorer:
    """Construct the configured explorer. Raises EmbodiedActiveLearningError if its class is incomplete."""
    name = config.exploration.explorer
    try:
        explorer: Explorer = EXPLORERS[name](config, seed)
        planned = np.shape(explorer.planned_states)
    except (AttributeError, TypeError) as error:
        if error.__traceback__ is not None and error.__traceback__.tb_next is not None:
            raise  # by code of the explorer: the traceback shows where
        raise EmbodiedActiveLearningError(f"explorer {name} cannot be used: {error}") from error
    if len(planned) != 2:
        raise EmbodiedActiveLearningError(
            f"explorer {name} cannot be used: planned_states has shape {planned}: make it a property that returns an "
            "array (H, 3)"
        )
    return explorer
