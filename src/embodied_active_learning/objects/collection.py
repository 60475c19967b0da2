"""Collection of the views of one object by ergodic control around its centre.

Paper, Sec. "Object Fingerprinting" and limitations: views are spread over a normal distribution around the centre.
"""

from __future__ import annotations

from dataclasses import replace
from typing import List

import numpy as np

from embodied_active_learning.config import Config, FingerprintConfig, PlannerConfig, WorkspaceConfig
from embodied_active_learning.exploration.commands import VelocityCommand
from embodied_active_learning.exploration.controller import ErgodicController
from embodied_active_learning.exploration.ergodic_objective import normalise
from embodied_active_learning.exploration.samples import WorkspaceSamples
from embodied_active_learning.geometry import pose_distance
from embodied_active_learning.workspace import Workspace

_KERNEL_VARIANCE = 0.02
"""Variance of the coverage kernel, in units of the view box.

The wider the kernel, the closer the views stay to the centre. The authors' code uses a tenth of the variance used in
exploration, which would be 0.036 here.
"""
_STEP_LIMIT_FACTOR = 4
"""Give up after this many times the planned number of steps: further views would be duplicates."""


class ViewCollection:
    """Ergodic control in the view box around an object's centre, clipped to the workspace.

    Move the camera to `start`, then alternate `observe` and `next_command` until the collection is `complete` or
    `exhausted`.
    """

    def __init__(self, config: Config, centre: np.ndarray, seed: int) -> None:
        """Plan views of a centre (3,) [m, m, rad]. One seed gives one sequence of commands."""
        self._settings = config.fingerprint
        local = _view_box_config(config, centre, seed)
        self._workspace = local.workspace.box()
        self._samples = WorkspaceSamples(local)
        self._controller = ErgodicController(local, seed)
        self._target = self._target_distribution(centre)
        self._steps = 0
        self._states: List[np.ndarray] = []
        self._images: List[np.ndarray] = []
        self.start = self._workspace.clip(centre)

    @property
    def states(self) -> np.ndarray:
        """(V, 3) camera states [m, m, rad] of the kept views."""
        return np.array(self._states).reshape(-1, self._workspace.size)

    @property
    def images(self) -> np.ndarray:
        """(V, H, W, 3) uint8 images of the kept views."""
        return np.array(self._images)

    @property
    def complete(self) -> bool:
        """Whether `fingerprint/views` views were kept."""
        return len(self._states) >= self._settings.views

    @property
    def exhausted(self) -> bool:
        """Whether the step limit was reached: more steps are unlikely to give new views."""
        return self._steps >= _STEP_LIMIT_FACTOR * self._settings.views * self._settings.steps_per_view

    def observe(self, state: np.ndarray, velocity: np.ndarray, image: np.ndarray) -> bool:
        """Record the state reached by a step, and keep its image every `steps_per_view` steps unless it is a duplicate.

        Args:
            state: (3,) x [m], y [m], theta [rad].
            velocity: (3,) in m/s, m/s, rad/s.
            image: (H, W, 3) uint8 taken at the state.

        Returns:
            Whether the image was kept.
        """
        keep = self._steps % self._settings.steps_per_view == 0 and is_new_view(state, self.states, self._settings)
        if keep:
            self._states.append(np.array(state, dtype=np.float64))
            self._images.append(np.array(image))
        self._steps += 1
        normalised = self._workspace.normalise(state)
        self._samples.visit(normalised)
        self._controller.observe(normalised, velocity)
        return keep

    def next_command(self) -> VelocityCommand:
        """Return the next command for the arm."""
        return self._controller.next_command(self._target, self._samples)

    def interrupt(self) -> None:
        """Reset the controller after the arm was stopped."""
        self._controller.reset()

    def _target_distribution(self, centre: np.ndarray) -> np.ndarray:
        """Normalised view density (S,) at the samples."""
        states = self._workspace.denormalise(self._samples.states)
        return normalise(np.exp(log_view_density(states, centre, self._workspace, self._settings)))


def log_view_density(
    states: np.ndarray, centre: np.ndarray, workspace: Workspace, settings: FingerprintConfig
) -> np.ndarray:
    """Return the unnormalised log density (S,) of views of an object at camera states (S, 3) [m, m, rad].

    Normal in x and y around the object's centre (3,); nearly uniform in yaw, around the middle of the workspace.
    """
    mean = np.array([centre[0], centre[1], workspace.centre[2]])
    std = np.array([settings.view_std, settings.view_std, settings.view_yaw_std])
    return -0.5 * np.square((states - mean) / std).sum(axis=1)


def is_new_view(state: np.ndarray, kept: np.ndarray, settings: FingerprintConfig) -> bool:
    """Return whether a view from a state (3,) is not a duplicate of any kept view, from states (V, 3) [m, m, rad]."""
    if not len(kept):
        return True
    distance, turn = pose_distance(kept, state)
    return not np.any((distance < settings.min_view_distance) & (turn < settings.min_view_turn))


def _view_box_config(config: Config, centre: np.ndarray, seed: int) -> Config:
    """Return a configuration whose workspace is the view box around a centre, clipped to the real workspace.

    Top speed shrinks with the box, so that a step covers the same share of this workspace as of the real one. Kernels
    are normalised and random plans compared in every profile: else the controller can stay in a corner of the box.
    """
    box, size = config.workspace.box(), config.fingerprint.view_box
    middle = box.clip(centre)
    limits = [(max(box.lower[i], middle[i] - size), min(box.upper[i], middle[i] + size)) for i in range(2)]
    workspace = WorkspaceConfig(x=limits[0], y=limits[1], theta=(box.lower[2], box.upper[2]))
    speed_ratio = min(1.0, size / float(box.scale[:2].min()))
    return replace(
        config,
        workspace=workspace,
        simulation=replace(config.simulation, start=tuple(workspace.box().centre)),
        arm=replace(config.arm, max_speed=speed_ratio * config.arm.max_speed),
        planner=replace(config.planner, normalise_kernels=True, random_candidates=PlannerConfig().random_candidates),
        exploration=replace(config.exploration, seed=seed, sample_box=1.0, kernel_variance=_KERNEL_VARIANCE),
    )
