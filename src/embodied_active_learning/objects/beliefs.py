"""Belief grids: how likely a fingerprint's object is present at each planar pose.

Paper, appendix "Object Identification": a regular grid with a mean and a standard deviation at each point, updated for
each image by Bayes' rule.
"""

from __future__ import annotations

import math
from typing import Iterable, List, NamedTuple, Tuple

import numpy as np
import torch
from scipy.ndimage import maximum_filter

from embodied_active_learning.config import COUNTED, IdentificationConfig
from embodied_active_learning.errors import ConfigError
from embodied_active_learning.geometry import wrap
from embodied_active_learning.workspace import Workspace

_PRIOR_MEAN = 0.5
_PRIOR_VARIANCE = 2.0
_MIN_RANGE = 0.05
"""Smallest range of a scale: small variations of uniform beliefs do not look like peaks."""
_BATCH = 16
"""Measurements per matrix product: few enough to stay in the CPU cache."""


class Peak(NamedTuple):
    """A local maximum of a belief.

    Attributes:
        pose: (3,) x [m], y [m], theta [rad].
        mean: Mean belief at the peak, 0 to 1.
        std: Standard deviation of the belief at the peak.
    """

    pose: np.ndarray
    mean: float
    std: float


class BeliefGrid:
    """Mean and standard deviation at the centre of each cell, over x, y and the full circle of yaw.

    A measurement m with variance r(s) is a Gaussian likelihood at each cell s, and Bayes' rule multiplies it with the
    cell's Gaussian belief. In information form (1 / variance, mean / variance) the update is a sum, so the order of
    images does not matter.
    """

    def __init__(self, workspace: Workspace, settings: IdentificationConfig) -> None:
        """Create a grid over the workspace and its margin [m] at the prior: mean 0.5, variance 2.

        Raises:
            ConfigError: No cell lies inside the workspace.
        """
        self._settings = settings
        nx, ny, nyaw = settings.cells
        lower, upper = (np.asarray(limit[:2]) for limit in (workspace.lower, workspace.upper))
        self.x = np.linspace(lower[0] - settings.margin, upper[0] + settings.margin, nx)
        self.y = np.linspace(lower[1] - settings.margin, upper[1] + settings.margin, ny)
        self.yaw = (np.arange(nyaw) + 0.5) / nyaw * 2.0 * math.pi - math.pi
        any_yaw = np.full((nx, ny), workspace.centre[2])
        self._inside = workspace.contains(np.stack([*np.meshgrid(self.x, self.y, indexing="ij"), any_yaw], -1))
        if not self._inside.any():
            raise ConfigError(
                f"no cell of the belief grid lies inside the workspace: identification/cells is {list(settings.cells)} "
                f"and identification/margin {settings.margin:g} m; use more cells or a smaller margin"
            )
        self._information = np.full((nx, ny, nyaw), 1.0 / _PRIOR_VARIANCE)
        self._weighted = self._information * _PRIOR_MEAN

    @property
    def mean(self) -> np.ndarray:
        """(nx, ny, nyaw) mean belief in [0, 1]."""
        return self._weighted / self._information

    @property
    def std(self) -> np.ndarray:
        """(nx, ny, nyaw) standard deviation of the belief."""
        return 1.0 / np.sqrt(self._information)

    def update(self, poses: np.ndarray, values: np.ndarray, weights: np.ndarray) -> None:
        """Update the belief with N measurements (Paper, appendix "Object Identification", steps 3 and 4).

        The variance rises from `near_variance` at the measured pose to `near_variance / far_pull` outside the Gaussian
        footprint K: r = far + K (near - far). In the authors' code, K is 1 at the border cell nearest to a pose outside
        the grid; here K keeps its value there.

        Args:
            poses: (N, 3) measured object poses [m, m, rad].
            values: (N,) measurements in [0, 1].
            weights: (N,) factors of the information, 1 for an independent image.
        """
        settings = self._settings
        ratio = 1.0 / settings.far_pull
        # K is 1 in the cell that contains the pose, wherever in the cell the pose lies.
        inside = self._covers(poses)
        along_x = torch.from_numpy(_footprints(self.x - poses[:, :1], settings.kernel_std, inside))
        along_y = torch.from_numpy(_footprints(self.y - poses[:, 1:2], settings.kernel_std, inside))
        along_yaw = torch.from_numpy(_footprints(wrap(self.yaw - poses[:, 2:]), settings.kernel_yaw_std, inside))
        shares = torch.from_numpy(np.stack([weights, weights * values]) / settings.near_variance)
        sums = torch.zeros((2, self._information.size), dtype=torch.float64)
        for begin in range(0, len(poses), _BATCH):
            part = slice(begin, begin + _BATCH)
            plane = (1.0 - ratio) * along_x[part, :, None] * along_y[part, None, :]
            variances = (plane.flatten(1)[..., None] * along_yaw[part, None, :]).add_(ratio)  # of near_variance
            sums.addmm_(shares[:, part], variances.reciprocal_().flatten(1))
        self._information += sums[0].numpy().reshape(self._information.shape)
        self._weighted += sums[1].numpy().reshape(self._information.shape)

    def over_yaw(self) -> Tuple[np.ndarray, np.ndarray]:
        """Return the largest mean over yaw (nx, ny) and its standard deviation (nx, ny)."""
        mean = self.mean
        best = mean.argmax(axis=2)[..., None]
        return np.take_along_axis(mean, best, 2)[..., 0], np.take_along_axis(self.std, best, 2)[..., 0]

    def above_median(self) -> np.ndarray:
        """Return the height (nx, ny) of the largest mean over yaw above its median over the grid."""
        return above_median(self.over_yaw()[0])

    def peaks(self, distance: float, max_count: int) -> List[Peak]:
        """Return local maxima inside the workspace, highest first.

        Args:
            distance: Smallest distance [m] between two peaks.
            max_count: Largest number of peaks.
        """
        mean = self.mean
        highest = np.where(self._inside, mean.max(axis=2), -1.0)
        spacing = (self.x[1] - self.x[0], self.y[1] - self.y[0])
        size = [2 * max(1, int(0.5 * distance / step)) + 1 for step in spacing]
        rows, columns = np.nonzero((maximum_filter(highest, size) == highest) & self._inside)
        found: List[Peak] = []
        for index in np.argsort(-highest[rows, columns], kind="stable"):
            row, column = rows[index], columns[index]
            yaw = int(mean[row, column].argmax())
            pose = np.array([self.x[row], self.y[column], self.yaw[yaw]])
            if all(np.hypot(*(pose - other.pose)[:2]) >= distance for other in found):
                top, std = float(highest[row, column]), 1.0 / math.sqrt(self._information[row, column, yaw])
                found.append(Peak(pose, top, std))
            if len(found) == max_count:
                break
        return found

    def value_at(self, pose: np.ndarray) -> Tuple[float, float]:
        """Return mean and standard deviation in the cell of a pose (3,)."""
        cell = (
            np.abs(self.x - pose[0]).argmin(),
            np.abs(self.y - pose[1]).argmin(),
            np.abs(wrap(self.yaw - pose[2])).argmin(),
        )
        information = self._information[cell]
        return float(self._weighted[cell] / information), float(1.0 / math.sqrt(information))

    def yaw_peaks(self, pose: np.ndarray, max_count: int) -> List[float]:
        """Return yaws [rad] of local maxima in the cell of a pose (3,), highest first, or its own yaw."""
        row, column = np.abs(self.x - pose[0]).argmin(), np.abs(self.y - pose[1]).argmin()
        mean = self._weighted[row, column] / self._information[row, column]
        top = np.flatnonzero((mean >= np.roll(mean, 1)) & (mean > np.roll(mean, -1)))
        return [float(self.yaw[index]) for index in top[np.argsort(-mean[top], kind="stable")][:max_count]] or [pose[2]]

    def _covers(self, poses: np.ndarray) -> np.ndarray:
        """Whether each of the poses (N, 3) lies on the grid: (N,) bool."""
        x, y = poses[:, 0], poses[:, 1]
        return (self.x[0] <= x) & (x <= self.x[-1]) & (self.y[0] <= y) & (y <= self.y[-1])


def above_median(values: np.ndarray) -> np.ndarray:
    """Subtract the median from a map (nx, ny): most of a map is background at about its median."""
    return values - np.median(values)


def shared_scale(maps: Iterable[np.ndarray]) -> float:
    """Return the end of the common colour scale of maps (nx, ny) from above_median: their largest value."""
    return max([_MIN_RANGE, *(float(one.max()) for one in maps)])


class EvidenceWeights:
    """Weights of the images of a stream: images from one camera state share the weight of one image.

    Images along a trajectory are not independent, so the n-th image from the same state has weight 1/n. The paper does
    not mention such a weight; `identification/evidence: counted` sets all weights to 1.
    """

    def __init__(self, settings: IdentificationConfig) -> None:
        """Start a stream."""
        self._settings = settings
        self._states = np.empty((0, 3))

    def update(self, states: np.ndarray) -> np.ndarray:
        """Return the weights (N,) of the stream's next images, taken from states (N, 3) [m, m, rad]."""
        before, settings = len(self._states), self._settings
        self._states = np.concatenate([self._states, states])
        if settings.evidence == COUNTED:
            return np.ones(len(states))
        weights = np.empty(len(states))
        for index, state in enumerate(states):
            change = self._states[: before + index + 1] - state
            near = np.square(change[:, :2] / settings.independence_distance).sum(axis=1)
            near += np.square(wrap(change[:, 2]) / settings.independence_turn)
            weights[index] = 1.0 / np.exp(-0.5 * near).sum()
        return weights


def _footprints(offsets: np.ndarray, std: float, inside: np.ndarray) -> np.ndarray:
    """Gaussians of offsets (N, C) along one axis, scaled to a maximum of 1 where `inside` (N,) is true."""
    energy = 0.5 * np.square(offsets / std)
    return np.exp(np.where(inside, energy.min(axis=1), 0.0)[:, None] - energy)
