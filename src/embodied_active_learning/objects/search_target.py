"""A fingerprint that is being searched for: its measurements so far and its belief grid."""

from __future__ import annotations

from typing import List

import numpy as np

from embodied_active_learning.objects.beliefs import BeliefGrid
from embodied_active_learning.objects.fingerprint import Fingerprint, FingerprintSet
from embodied_active_learning.objects.matching import Matches
from embodied_active_learning.objects.verification import Verifier


class SearchTarget:
    """One fingerprint of one session, with what the images of the stream contributed to it."""

    def __init__(
        self,
        fingerprint_set: FingerprintSet,
        fingerprint: Fingerprint,
        threshold: float,
        grid: BeliefGrid,
        verifier: Verifier,
    ) -> None:
        """Start a search.

        Args:
            fingerprint_set: The set that contains the fingerprint.
            fingerprint: What to search for.
            threshold: Latent distance at which a measurement is 1/2.
            grid: The belief, at its prior.
            verifier: Compares views of candidates with the fingerprint.
        """
        self.session = fingerprint_set.session
        self.fingerprint = fingerprint
        self.threshold = threshold
        self.grid = grid
        self.verifier = verifier
        self._parts: List[Matches] = []

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

    def observe(self, matches: Matches, weights: np.ndarray) -> None:
        """Update the belief with the measurements of N images and the evidence weight (N,) of each."""
        self._parts.append(matches)
        self.grid.update(matches.pose, matches.value, weights)
