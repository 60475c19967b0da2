"""One worker as the owner sees it: its tasks, its results and its part of the messages."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import List, NamedTuple, Optional

import torch

from embodied_active_learning.distributed.link import Link, LinkError
from embodied_active_learning.distributed.messages import IDLE, OBSERVATIONS, Header, empty_response
from embodied_active_learning.model.batches import ObservationSource

CHUNK = 64  # observations in one message while a worker joins


@dataclass
class WorkerStatus:
    """One worker, for diagnostics."""

    slot: int
    rounds: int = 0
    updates: int = 0
    bytes: int = 0
    updates_per_second: float = 0.0  # in the last round, transfers included
    lag: float = 0.0  # s, by which its last result came after the owner's own
    seen: float = 0.0  # time.monotonic() of its last response


class Task(NamedTuple):
    """A worker's part of a round."""

    header: Header
    observations: int  # that the worker must have
    weights: torch.Tensor  # (P,)
    moments: Optional[torch.Tensor]  # (2 P + 1,)


class Result(NamedTuple):
    """Updates made by a worker in a round, and its weights (P,)."""

    updates: int
    weights: torch.Tensor


class RemoteWorker:
    """A worker that the owner has a link to. A thread of its own exchanges messages with it.

    Attributes:
        task: What it has to do, until the result is there.
        result: Of its last task.
        rollbacks: Of the owner when the worker got its moments.
        dropped: Whether it takes no part any more.
    """

    def __init__(self, link: Link, slot: int, timeout: float) -> None:
        self._link = link
        self._timeout = timeout
        self._observations = 0
        self._weights = torch.zeros(0)
        self.status = WorkerStatus(slot, seen=time.monotonic())
        self.task: Optional[Task] = None
        self.result: Optional[Result] = None
        self.rollbacks: Optional[int] = None
        self.dropped = False

    def send_observations(self, store: ObservationSource, limit: int) -> bool:
        """Send at most CHUNK of the first `limit` observations that the worker lacks; return whether it lacks more."""
        first, last = self._observations, min(limit, self._observations + CHUNK)
        if last > first:
            states = torch.from_numpy(store.states[first:last])
            images = torch.from_numpy(store.images[first:last])
            header = Header(OBSERVATIONS, observations=last - first).tensor()
            self._exchange(header, states, images)
            self._observations = last
        return last < limit

    def ping(self) -> None:
        """Exchange a message without content."""
        self._exchange(Header(IDLE).tensor())

    def make_updates(self, task: Task) -> Result:
        """Make the worker compute its updates. Raises LinkError also if the result is invalid."""
        began = time.monotonic()
        if len(self._weights) != len(task.weights):
            self._weights = torch.zeros_like(task.weights)
        moments = [] if task.moments is None else [task.moments]
        made = self._exchange(task.header.tensor(), task.weights, *moments, result=[self._weights])
        share = len(task.header.updates)
        if not (0 <= made <= share and bool(self._weights.isfinite().all())):
            raise LinkError(f"invalid result: {made:g} of {share} updates, or weights that are not finite")
        status = self.status
        status.rounds, status.updates = status.rounds + 1, status.updates + int(made)
        status.updates_per_second = made / max(1e-6, time.monotonic() - began)
        return Result(int(made), self._weights)

    def _exchange(self, *message: torch.Tensor, result: Optional[List[torch.Tensor]] = None) -> float:
        """Send a message, and return the number in the worker's response."""
        response = empty_response()
        sent = self._link.send(*message)
        # Waited for first: it fails at once if the worker has ended, which Gloo does not report for a pending send.
        self._link.receive(response, *(result or [])).wait(self._timeout)
        sent.wait(self._timeout)
        self.status.bytes, self.status.seen = self._link.bytes, time.monotonic()
        return float(response)
