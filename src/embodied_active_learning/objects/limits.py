"""Limits of the similarity, from what a fingerprint's object and look-alikes of it reach in simulated places.

The user states one number, `identification/error_rate`:

* miss limit: the quantile of the true similarities at that rate. Split conformal prediction: a new place from the same
  distribution falls below it with at most that probability.
* look-alike limit: the quantile of the false similarities at 1 - r, where r is that rate divided by the share of
  look-alikes among all other objects: most of these resemble the object in neither colour nor shape.

An object is found above both limits and not here below the miss limit. In between it is undecided, because a look-alike
would be as similar. Not guaranteed: that real changes of table and light are within the simulated ones, and that
real objects are at least as different as the look-alikes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from embodied_active_learning.errors import ObservationError

CALIBRATION_VERSION = 9
"""Version of similarity and calibration: stored limits of another version do not apply."""


_LOOK_ALIKE_SHARE = 0.25
"""Share of other objects that are look-alikes. With it, 5 of 480 pairs of a fingerprint and a scene had a claim where
its object does not stand, on development data at an error rate of 5 %."""
_MAX_RATE = 0.5
"""Largest accepted rate of look-alikes."""
_ROUNDING = 1e-9
"""Larger than the rounding error of a rank: 0.29 of 100 is 28.999999999999996."""


class Limits(NamedTuple):
    """Similarities between the outcomes: below `miss` an object is not here, from `found` it is found."""

    miss: float
    look_alike: float

    @property
    def found(self) -> float:
        """Similarity from which the object is found."""
        return max(self.miss, self.look_alike)


@dataclass(frozen=True, eq=False)
class Calibration:
    """Similarities that a fingerprint's object, and look-alikes of it, reach in simulated places.

    Attributes:
        true: (T,) float64 of the object, ascending: the smallest over the evaluations of each place.
        false: (F,) float64 of look-alikes, ascending: the largest over the evaluations of each place.

    Raises:
        ObservationError: If they are not ascending values in [-1, 1].
    """

    true: np.ndarray
    false: np.ndarray

    def __post_init__(self) -> None:
        """Check the values."""
        for values in (self.true, self.false):
            fits = values.dtype == np.float64 and values.ndim == 1 and len(values) > 0
            if not fits or not (np.abs(values) <= 1.0).all() or (np.diff(values) < 0.0).any():
                raise ObservationError("invalid calibration: expected ascending float64 similarities in [-1, 1]")

    @property
    def smallest_error_rate(self) -> float:
        """Error rate below which too few places were simulated: no similarity would be low enough for absence."""
        return 1.0 / (len(self.true) + 1)

    def limits(self, error_rate: float) -> Limits:
        """Return the limits at an accepted rate of errors."""
        rank = math.floor(error_rate * (len(self.true) + 1) + _ROUNDING)
        miss = float(self.true[rank - 1]) if rank else -1.0
        rate = min(_MAX_RATE, error_rate / _LOOK_ALIKE_SHARE)
        rank = math.ceil((1.0 - rate) * (len(self.false) + 1) - _ROUNDING)
        return Limits(miss, float(self.false[rank - 1]) if rank <= len(self.false) else 1.0)

    def confidence(self, value: float) -> float:
        """Return the share of the look-alikes that are less similar than a value; conformal, so below 1."""
        return float(np.searchsorted(self.false, value, side="left")) / (len(self.false) + 1)
