"""When the updates of the model are due, and which observations they use."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class UpdatePlan:
    """The updates of a run, as they follow from the number of observations alone.

    So training does not depend on the speed of planner and trainer. Example, with the defaults (3000 steps, 3 updates
    per observation from the 64th on) for one trainer, and for two that make 25 updates each in a round:

    | observations | due | awaited | due, two trainers | awaited, two trainers |
    | --- | --- | --- | --- | --- |
    | 63 | 0 | 0 | 0 | 0 |
    | 64 | 3 | 0 | 0 | 0 |
    | 65 | 6 | 3 | 0 | 0 |
    | 80 | 51 | 48 | 50 | 0 |
    | 2999 | 8808 | 8805 | 8800 | 8750 |
    | 3000 | 9000 | 9000 | 9000 | 9000 |

    Attributes:
        steps: Observations of the whole run.
        first_update_at: Observations before the first update.
        per_observation: Updates per observation.
        per_refresh: Updates between two models that the planner may query: those of an observation, or of a round of
            several trainers.
    """

    steps: int
    first_update_at: int
    per_observation: int
    per_refresh: int

    @property
    def total(self) -> int:
        """Number of updates of the whole run."""
        return self.per_observation * self.steps

    def observations_needed(self, update: int) -> int:
        """Return the number of observations that the batches of an update (from 0) are drawn from.

        With the defaults, updates 0 to 2 need 64, updates 3 to 5 need 65, and updates 8808 to 8999 need all 3000.
        """
        return self._observations_for(update + 1)

    def due(self, observations: int) -> int:
        """Return the number of updates due after a number of observations; all when exploration is complete.

        Before, only whole rounds are due.
        """
        if observations >= self.steps:
            return self.total
        due = self.per_observation * max(0, observations + 1 - self.first_update_at)
        return due - due % max(1, self.per_refresh)

    def awaited(self, observations: int) -> int:
        """Return the updates that the planner waits for after a number of observations, before training/max_lag.

        The newest updates that are due run while the arm moves; at the end all are awaited.
        """
        due = self.due(observations)
        return due if observations >= self.steps else max(0, due - self.per_refresh)

    def observations_awaiting(self, updates: int) -> int:
        """Return the number of observations after which the planner waits for a model with this many updates.

        The inverse of `awaited`, for a positive multiple of per_refresh; at most `steps`.
        """
        return self._observations_for(updates + self.per_refresh)

    def _observations_for(self, updates: int) -> int:
        """Return the smallest number of observations after which this many updates are due, whole rounds or not."""
        return min(self.steps, self.first_update_at - 1 + math.ceil(updates / self.per_observation))
