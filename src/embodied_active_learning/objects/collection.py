"""Views of one learned object, spread over a normal distribution around it (paper, Sec. 5, object fingerprinting)."""

from __future__ import annotations

from dataclasses import replace
from typing import List

import numpy as np

from embodied_active_learning.config import Config, FingerprintConfig, WorkspaceConfig
from embodied_active_learning.exploration.commands import VelocityCommand
from embodied_active_learning.exploration.controller import ErgodicController
from embodied_active_learning.exploration.objective import normalise
from embodied_active_learning.exploration.samples import WorkspaceSamples
from embodied_active_learning.geometry import pose_distance
from embodied_active_learning.workspace import Workspace

_KERNEL_VARIANCE = 0.02
"""Of the coverage kernel, in units of the view box. The wider it is, the closer the views stay to the centre; the
authors, who take a tenth of the exploration's variance, would have 0.036."""
_MOST_STEPS = 4
"""Times the planned number of steps after which a collection gives up: the views would all be the same."""


class ViewCollection:
    """Ergodic control around a centre, in a workspace of its own: the view box around it, where the camera can go.

    Begin at `start`; then, in turn, observe() and next_command() until it is complete or exhausted.
    """

    def __init__(self, config: Config, centre: np.ndarray, seed: int) -> None:
        """centre: (3,) m, m, rad. One seed gives one sequence of commands."""
        self._settings = config.fingerprint
        local = _around(config, centre, seed)
        self._workspace = local.workspace.box()
        self._samples = WorkspaceSamples(local)
        self._controller = ErgodicController(local, seed)
        self._target = self._normal(centre)
        self._steps = 0
        self._states: List[np.ndarray] = []
        self._images: List[np.ndarray] = []
        self.start = self._workspace.clip(centre)

    @property
    def states(self) -> np.ndarray:
        """(V, 3) m, m, rad: where the kept views were taken."""
        return np.array(self._states).reshape(-1, self._workspace.size)

    @property
    def images(self) -> np.ndarray:
        """(V, H, W, 3) uint8: the kept views."""
        return np.array(self._images)

    @property
    def complete(self) -> bool:
        """Whether there are as many views as asked for."""
        return len(self._states) >= self._settings.views

    @property
    def exhausted(self) -> bool:
        """Whether so many steps have been made that more of them will bring no new views."""
        return self._steps >= _MOST_STEPS * self._settings.views * self._settings.steps_per_view

    def observe(self, state: np.ndarray, velocity: np.ndarray, image: np.ndarray) -> bool:
        """Count a step that ended at a state (3,) with a velocity (3,), SI units. -> whether its image was kept."""
        keep = self._steps % self._settings.steps_per_view == 0 and self._is_new(state)
        if keep:
            self._states.append(np.array(state, dtype=np.float64))
            self._images.append(np.array(image))
        self._steps += 1
        normalised = self._workspace.normalise(state)
        self._samples.visit(normalised)
        self._controller.observe(normalised, velocity)
        return keep

    def next_command(self) -> VelocityCommand:
        """What the arm should do next."""
        return self._controller.next_command(self._target, self._samples)

    def interrupt(self) -> None:
        """Tell the controller that the arm was stopped."""
        self._controller.reset()

    def _is_new(self, state: np.ndarray) -> bool:
        return is_new(state, self.states, self._settings)

    def _normal(self, centre: np.ndarray) -> np.ndarray:
        """The target distribution (S,) over the samples."""
        states = self._workspace.denormalise(self._samples.states)
        return normalise(np.exp(log_density(states, centre, self._workspace, self._settings)))


def log_density(
    states: np.ndarray, centre: np.ndarray, workspace: Workspace, settings: FingerprintConfig
) -> np.ndarray:
    """How much views from states (S, 3) are wanted of an object at a centre (3,): a logarithm (S,), but for a constant.

    Normal in x and y around the centre, nearly even in yaw.
    """
    mean = np.array([centre[0], centre[1], workspace.centre[2]])
    std = np.array([settings.view_std, settings.view_std, settings.view_yaw_std])
    return -0.5 * np.square((states - mean) / std).sum(axis=1)


def is_new(state: np.ndarray, kept: np.ndarray, settings: FingerprintConfig) -> bool:
    """Whether a view from a state (3,) is no duplicate of one that was kept (V, 3)."""
    if not len(kept):
        return True
    distance, turn = pose_distance(kept, state)
    return not np.any((distance < settings.min_view_distance) & (turn < settings.min_view_turn))


def _around(config: Config, centre: np.ndarray, seed: int) -> Config:
    """The configuration whose workspace is the view box around a centre, cut to the real workspace.

    The arm is slowed down with the size of the box, so that a step takes it as far across this workspace as across the
    real one.
    """
    box, size = config.workspace.box(), config.fingerprint.view_box
    middle = box.clip(centre)
    limits = [(max(box.lower[i], middle[i] - size), min(box.upper[i], middle[i] + size)) for i in range(2)]
    workspace = WorkspaceConfig(x=limits[0], y=limits[1], theta=(box.lower[2], box.upper[2]))
    slower = min(1.0, size / float(box.scale[:2].min()))
    return replace(
        config,
        workspace=workspace,
        simulation=replace(config.simulation, start=tuple(workspace.box().centre)),
        arm=replace(config.arm, max_speed=slower * config.arm.max_speed),
        exploration=replace(config.exploration, seed=seed, sample_box=1.0, kernel_variance=_KERNEL_VARIANCE),
    )
