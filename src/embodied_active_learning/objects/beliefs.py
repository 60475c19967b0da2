"""Belief grids: how likely a fingerprint's object is at each planar pose (paper, appendix, object identification)."""

from __future__ import annotations

import math
from typing import List, NamedTuple, Tuple

import numpy as np
import torch
from scipy.ndimage import maximum_filter

from embodied_active_learning.config import IdentificationConfig
from embodied_active_learning.geometry import wrap
from embodied_active_learning.workspace import Workspace

_PRIOR_MEAN = 0.5
_PRIOR_VARIANCE = 2.0
_BATCH = 16
"""Measurements that are laid over the grid at a time: few enough to stay in the cache."""


class Peak(NamedTuple):
    """A local maximum of a belief."""

    pose: np.ndarray  # (3,) m, m, rad
    mean: float
    std: float
    rise: float  # of the mean above the median of all places, each at its best yaw


class BeliefGrid:
    """Mean and standard deviation at the middle of each cell, over x, y and the full circle of yaw.

    A measurement m of variance r(s) is a Gaussian likelihood at each cell s, and Bayes' rule multiplies it to what the
    cell believes. Kept as information (1 / variance, mean / variance) it is a sum: the order of images does not
    matter.
    """

    def __init__(self, workspace: Workspace, settings: IdentificationConfig) -> None:
        """A grid over the workspace and its margin, at the prior."""
        self._settings = settings
        nx, ny, nyaw = settings.cells
        lower, upper = (np.asarray(limit[:2]) for limit in (workspace.lower, workspace.upper))
        self.x = np.linspace(lower[0] - settings.margin, upper[0] + settings.margin, nx)
        self.y = np.linspace(lower[1] - settings.margin, upper[1] + settings.margin, ny)
        self.yaw = (np.arange(nyaw) + 0.5) / nyaw * 2.0 * math.pi - math.pi
        self._workspace = workspace
        self._information = np.full((nx, ny, nyaw), 1.0 / _PRIOR_VARIANCE)
        self._weighted = self._information * _PRIOR_MEAN

    @property
    def mean(self) -> np.ndarray:
        """(nx, ny, nyaw) in [0, 1]."""
        return self._weighted / self._information

    @property
    def std(self) -> np.ndarray:
        """(nx, ny, nyaw)."""
        return 1.0 / np.sqrt(self._information)

    def update(self, poses: np.ndarray, values: np.ndarray, weights: np.ndarray) -> None:
        """Measurements (N,) in [0, 1] that point to poses (N, 3) [m, m, rad]; a weight of 1/2 halves the information.

        The variance rises from near_variance at the pose to that over far_pull where the footprint K ends:
        r = far + K (near - far). The authors let K reach 1 at the border cell next to a pose outside of the grid; here
        the footprint only reaches in as far as it does.
        """
        settings = self._settings
        ratio = 1.0 / settings.far_pull
        # The cell next to a pose on the grid takes the measurement in full, wherever in the cell the pose lies.
        full = self._covers(poses)
        along_x = torch.from_numpy(_footprints(self.x - poses[:, :1], settings.kernel_std, full))
        along_y = torch.from_numpy(_footprints(self.y - poses[:, 1:2], settings.kernel_std, full))
        along_yaw = torch.from_numpy(_footprints(wrap(self.yaw - poses[:, 2:]), settings.kernel_yaw_std, full))
        shares = torch.from_numpy(np.stack([weights, weights * values]) / settings.near_variance)
        sums = torch.zeros((2, self._information.size), dtype=torch.float64)
        for begin in range(0, len(poses), _BATCH):
            part = slice(begin, begin + _BATCH)
            plane = (1.0 - ratio) * along_x[part, :, None] * along_y[part, None, :]
            variances = (plane.flatten(1)[..., None] * along_yaw[part, None, :]).add_(ratio)  # 1 is near_variance
            sums.addmm_(shares[:, part], variances.reciprocal_().flatten(1))
        self._information += sums[0].numpy().reshape(self._information.shape)
        self._weighted += sums[1].numpy().reshape(self._information.shape)

    def over_yaw(self) -> Tuple[np.ndarray, np.ndarray]:
        """Largest mean over yaw at each place, and the standard deviation there. -> (nx, ny), (nx, ny)."""
        mean = self.mean
        best = mean.argmax(axis=2)[..., None]
        return np.take_along_axis(mean, best, 2)[..., 0], np.take_along_axis(self.std, best, 2)[..., 0]

    def peaks(self, distance: float, most: int) -> List[Peak]:
        """Local maxima inside the workspace, the highest first. No two are closer than a distance [m]."""
        mean = self.mean
        inside = self._workspace.contains(
            np.stack([*np.meshgrid(self.x, self.y, indexing="ij"), 0.0 * mean[..., 0]], -1)
        )
        highest = np.where(inside, mean.max(axis=2), -1.0)
        spacing = (self.x[1] - self.x[0], self.y[1] - self.y[0])
        size = [2 * max(1, int(0.5 * distance / step)) + 1 for step in spacing]
        rows, columns = np.nonzero((maximum_filter(highest, size) == highest) & inside)
        median = float(np.median(mean.max(axis=2)))
        found: List[Peak] = []
        for index in np.argsort(-highest[rows, columns], kind="stable"):
            row, column = rows[index], columns[index]
            yaw = int(mean[row, column].argmax())
            pose = np.array([self.x[row], self.y[column], self.yaw[yaw]])
            if all(np.hypot(*(pose - other.pose)[:2]) >= distance for other in found):
                top, std = float(highest[row, column]), 1.0 / math.sqrt(self._information[row, column, yaw])
                found.append(Peak(pose, top, std, top - median))
            if len(found) == most:
                break
        return found

    def yaws(self, pose: np.ndarray, most: int) -> List[float]:
        """Local maxima of the mean over yaw [rad] in the cell of a pose (3,), the highest first."""
        row, column = np.abs(self.x - pose[0]).argmin(), np.abs(self.y - pose[1]).argmin()
        mean = self._weighted[row, column] / self._information[row, column]
        top = np.flatnonzero((mean >= np.roll(mean, 1)) & (mean > np.roll(mean, -1)))
        return [float(self.yaw[index]) for index in top[np.argsort(-mean[top], kind="stable")][:most]] or [pose[2]]

    def _covers(self, poses: np.ndarray) -> np.ndarray:
        """(N,) which of the poses (N, 3) lie on the grid."""
        x, y = poses[:, 0], poses[:, 1]
        return (self.x[0] <= x) & (x <= self.x[-1]) & (self.y[0] <= y) & (y <= self.y[-1])


class EvidenceWeights:
    """How much each image of a stream counts: those from one place share the weight of one.

    The first image of a place counts fully, the n-th one as 1/n: images along a trajectory are not independent.
    """

    def __init__(self, settings: IdentificationConfig) -> None:
        self._settings = settings
        self._seen = np.empty((0, 3))

    def of(self, states: np.ndarray) -> np.ndarray:
        """Weights (N,) of the next images of the stream, from states (N, 3) [m, m, rad]."""
        before, settings = len(self._seen), self._settings
        self._seen = np.concatenate([self._seen, states])
        if settings.evidence == "counted":
            return np.ones(len(states))
        weights = np.empty(len(states))
        for index, state in enumerate(states):
            change = self._seen[: before + index + 1] - state
            near = np.square(change[:, :2] / settings.independence_distance).sum(axis=1)
            near += np.square(wrap(change[:, 2]) / settings.independence_turn)
            weights[index] = 1.0 / np.exp(-0.5 * near).sum()
        return weights


def _footprints(away: np.ndarray, std: float, full: np.ndarray) -> np.ndarray:
    """Gaussians of distances (N, C) along one axis; full (N,): where the largest value is made 1."""
    energy = 0.5 * np.square(away / std)
    return np.exp(np.where(full, energy.min(axis=1), 0.0)[:, None] - energy)
