"""A fingerprint that is being searched for: its measurements so far and its belief grid."""

from __future__ import annotations

from functools import cached_property
from typing import List

import numpy as np

from embodied_active_learning.model.trained_model import TrainedModel
from embodied_active_learning.objects.appearance import Appearance
from embodied_active_learning.objects.bare_table import BareTable
from embodied_active_learning.objects.beliefs import BeliefGrid
from embodied_active_learning.objects.calibration import calibrate
from embodied_active_learning.objects.fingerprint import OBJECT, Fingerprint, FingerprintSet
from embodied_active_learning.objects.limits import Calibration
from embodied_active_learning.objects.matching import Matches


class SearchTarget:
    """One fingerprint of one session, with what the images of the stream contributed to it."""

    def __init__(
        self,
        fingerprint_set: FingerprintSet,
        fingerprint: Fingerprint,
        model: TrainedModel,
        threshold: float,
        grid: BeliefGrid,
        error_rate: float,
    ) -> None:
        """Start a search.

        Args:
            fingerprint_set: The set that contains the fingerprint.
            fingerprint: What to search for.
            model: The model of the set.
            threshold: Latent distance at which a measurement is 1/2.
            grid: The belief, at its prior.
            error_rate: Error rate that its calibration has to allow.
        """
        self.session = fingerprint_set.session
        self.fingerprint = fingerprint
        self.without_prints = fingerprint_set.without_prints
        self.model = model
        self.threshold = threshold
        self.grid = grid
        self._set = fingerprint_set
        self._error_rate = error_rate
        self._parts: List[Matches] = []

    @cached_property
    def appearance(self) -> Appearance:
        """What the object looks like, learned when it is first needed."""
        return Appearance(self.fingerprint, self._set.fingerprints, self._set.config.camera)

    @property
    def problem(self) -> str:
        """Why an object cannot be recognised, and the remedy; empty if it can, and of a blank."""
        if self.fingerprint.kind != OBJECT:
            return ""
        if self.appearance.problem:
            return self.appearance.problem
        smallest = self.calibration.smallest_error_rate
        if self._error_rate >= smallest:
            return ""
        return (
            f"its limits hold for error rates from {smallest:.3g} on, not {self._error_rate:g}: raise "
            "fingerprint/trials, then fingerprint the session again"
        )

    @property
    def needs_calibration(self) -> bool:
        """Whether an object has no stored calibration: it cannot be recognised, or its file is older."""
        return self.fingerprint.kind == OBJECT and self.fingerprint.calibration is None

    @cached_property
    def calibration(self) -> Calibration:
        """The stored calibration; without one it is computed when it is first needed, which takes a second."""
        return self.fingerprint.calibration or calibrate(self.appearance, self._set.config.fingerprint.trials)

    @cached_property
    def bare_table(self) -> BareTable:
        """The table of a blank, learned when it is first needed."""
        return BareTable(self.fingerprint, self._set.fingerprints, self._set.config.camera)

    @property
    def label(self) -> str:
        """Session and name, such as `table-1/object-2`."""
        return f"{self.session}/{self.fingerprint.name}"

    @property
    def trace(self) -> Matches:
        """The measurements of all images so far."""
        if not self._parts:
            return Matches(np.empty(0, np.int32), np.empty(0, np.float32), np.empty(0, np.float32), np.empty((0, 3)))
        if len(self._parts) > 1:
            names = ("view", "distance", "value", "pose")
            joined = Matches(*(np.concatenate([getattr(part, name) for part in self._parts]) for name in names))
            self._parts = [joined]
        return self._parts[0]

    def reset(self, grid: BeliefGrid) -> None:
        """Forget all measurements and start from another belief."""
        self.grid = grid
        self._parts = []

    def observe(self, matches: Matches, weights: np.ndarray) -> None:
        """Update the belief with the measurements of N images and the evidence weight (N,) of each."""
        self._parts.append(matches)
        self.grid.update(matches.pose, matches.value, weights)
