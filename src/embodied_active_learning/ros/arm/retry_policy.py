"""Retry policy of the arm client: which failures are retried, how often and after which pause."""

from __future__ import annotations

import math
import time
from typing import NamedTuple, Optional

from embodied_active_learning.errors import (
    ArmBusyError,
    ArmStoppedError,
    EmbodiedActiveLearningError,
    NoResponseError,
    ObservationError,
)

RETRY_PERIOD = 0.5
"""Wall seconds before the first retry; doubled with each consecutive failure of the arm ..."""
MAX_RETRY_PERIOD = 8.0
"""... up to this."""
UNCOUNTED = (ObservationError, ArmBusyError, ArmStoppedError, NoResponseError)
"""Failures that only time or a person can resolve: retried until the timeout, without counting."""


class Retry(NamedTuple):
    """A retry that is due after a pause [s], and the failure to report meanwhile."""

    pause: float
    message: str


class RetryPolicy:
    """Counts consecutive failures. Raises the error once retries or timeout are used up."""

    def __init__(self, retries: int, timeout: Optional[float] = None) -> None:
        """Allow `retries` consecutive counted failures, and `timeout` wall seconds from the first failure of a call.

        None waits forever.
        """
        self._retries = retries
        self._timeout = math.inf if timeout is None else timeout
        self._deadline = math.inf
        self._failures = 0
        self._cancelled = False

    def begin_call(self) -> None:
        """Start a call. Its timeout starts with its first failure, so that long commands do not count."""
        self._cancelled = False
        self._deadline = math.inf

    def cancel(self) -> None:
        """Retry nothing until the next call begins."""
        self._cancelled = True

    def reset(self) -> None:
        """Forget the failures: the arm has carried out a command."""
        self._failures = 0

    def after(self, error: EmbodiedActiveLearningError) -> Retry:
        """Return the retry after a failure. Raises the error instead if it is not retried any more."""
        if self._cancelled:
            raise error
        pause, message = RETRY_PERIOD, str(error)
        if not isinstance(error, UNCOUNTED):
            self._failures += 1
            attempt = self._failures
            if attempt > self._retries:
                self._failures = 0
                raise type(error)(f"{error} (gave up after {attempt} attempts)") from error
            pause = min(RETRY_PERIOD * 2 ** (attempt - 1), MAX_RETRY_PERIOD)
            message += f" (attempt {attempt} of {self._retries + 1}, next in {pause:g} s)"
        if math.isinf(self._deadline):
            self._deadline = time.monotonic() + self._timeout
        remaining = self._deadline - time.monotonic()
        if remaining <= 0.0:
            self._failures = 0
            raise error
        return Retry(min(pause, remaining), message)
