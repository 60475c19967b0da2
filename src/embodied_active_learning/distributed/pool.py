"""The owner's side: accepts workers, hands out rounds, and drops workers that fail."""

from __future__ import annotations

import json
import logging
import threading
import time
from dataclasses import dataclass
from typing import Callable, List

import torch

from embodied_active_learning.config import Config
from embodied_active_learning.distributed.link import (
    LINK_TIMEOUT_FACTOR,
    OWNER,
    Link,
    LinkError,
    connect_store,
    serve_store,
)
from embodied_active_learning.distributed.messages import CONFIG, ROUND, TICKETS, Header, ticket_name
from embodied_active_learning.distributed.remote_worker import RemoteWorker, Result, Task, WorkerStatus
from embodied_active_learning.model.batches import ObservationSource
from embodied_active_learning.model.learner import Learner

LOG = logging.getLogger(__name__)
_MAX_JOINING = 16  # workers that may join at once
_POLL_PERIOD = 0.1  # s
_IDLE_PERIOD = 1.0  # s, between two messages to a worker that has nothing to do


@dataclass(frozen=True)
class RoundReport:
    """A round: number of updates after it, trainers that took part, updates made, duration and computing time [s]."""

    update: int
    trainers: int
    updates: int
    seconds: float
    computing: float


class WorkerPool:
    """The workers of a run. One thread calls make_round(); any may call status()."""

    def __init__(self, config: Config, store: ObservationSource, address: str) -> None:
        """Listen for workers.

        Args:
            config: Of the run; workers get it from here.
            store: Observations, which workers get copies of.
            address: Of this computer; the only one that is listened on.

        Raises:
            LinkError: The address is not one of this computer's.
        """
        self._observations, self._host = store, address
        self._timeout, self._expected = config.training.worker_timeout, config.training.trainers - 1
        self._store, port = serve_store(address)
        self._store.set(CONFIG, json.dumps(config.to_dict()))
        self.address = f"{address}:{port}"
        """Where workers join, as "host:port"."""
        self._changed = threading.Condition()
        self._workers: List[RemoteWorker] = []  # with a link
        self._ready: List[RemoteWorker] = []  # for the next round
        self._busy: List[RemoteWorker] = []  # of the current round
        self._closed = False
        self._gathered = False
        self._joins = threading.Thread(target=self._accept_workers, name="trainers", daemon=True)
        self._joins.start()

    def make_round(
        self, learner: Learner, end: int, stop: threading.Event, make_update: Callable[[int], None]
    ) -> RoundReport:
        """Make updates together with the workers, and average the weights.

        Args:
            learner: The owner's.
            end: Number of updates to reach; fewer are made if a worker fails or stop is set.
            stop: Ends the round.
            make_update: Makes one of the owner's updates, given the number of trainers (see Learner.update).

        Raises:
            DivergenceError: The owner's model diverges.
        """
        self._gather(stop)
        first, began = learner.updates, time.monotonic()
        trainers = self._begin(learner, end)
        try:
            while learner.updates < end and not stop.is_set():
                make_update(trainers)
        finally:  # also after a divergence, so that the workers are ready for the next round
            own, computing = len(range(first, learner.updates, trainers)), time.monotonic() - began
            results = self._collect(stop)
        learner.average(first, own, results)
        return RoundReport(
            update=learner.updates,
            trainers=1 + len(results),
            updates=learner.updates - first,
            seconds=time.monotonic() - began,
            computing=computing,
        )

    def status(self) -> List[WorkerStatus]:
        """Return the workers that take part, by slot."""
        with self._changed:
            return sorted((worker.status for worker in self._ready), key=lambda status: status.slot)

    def close(self) -> None:
        """Drop all workers, and allow no more to join."""
        with self._changed:
            self._closed = True
            self._ready = []
            self._changed.notify_all()
        self._joins.join()

    def _gather(self, stop: threading.Event) -> None:
        """Before the first round, wait until all expected workers have joined, training/worker_timeout at most."""
        if self._gathered:
            return
        ends_at = time.monotonic() + self._timeout
        with self._changed:
            while len(self._ready) < self._expected and time.monotonic() < ends_at and not stop.is_set():
                self._changed.wait(_POLL_PERIOD)
            found = len(self._ready)
        self._gathered = True
        log = LOG.info if found >= self._expected else LOG.warning
        log("training with %d of %d trainers; others may join later", found + 1, self._expected + 1)

    def _begin(self, learner: Learner, end: int) -> int:
        """Begin a round that ends before update number `end`; return the number of trainers, with the owner.

        The owner makes the next update and each update whose number is larger by a multiple of that number of trainers.
        """
        with self._changed:
            busy = sorted(self._ready, key=lambda worker: worker.status.slot)
        trainers = 1 + len(busy)
        learner.prepare(trainers)
        weights = learner.weights() if busy else torch.zeros(0)
        moments = learner.moments() if any(worker.rollbacks != learner.rollbacks for worker in busy) else None
        for position, worker in enumerate(busy, start=1):
            joins = worker.rollbacks != learner.rollbacks
            start = learner.updates + position
            header = Header(
                ROUND,
                start=start,
                end=max(start, end),
                step=trainers,
                slot=worker.status.slot,
                rollbacks=learner.rollbacks,
                with_moments=int(joins),
                beta=learner.loss_weights.beta,
                gamma=learner.loss_weights.gamma,
            )
            worker.rollbacks, worker.result = learner.rollbacks, None
            worker.task = Task(header, len(self._observations), weights, moments if joins else None)
        with self._changed:
            self._busy = busy
            self._changed.notify_all()
        return trainers

    def _collect(self, stop: threading.Event) -> List[Result]:
        """Return the results of a round's workers. Those without one are dropped after the timeout or at a stop."""
        now = time.monotonic()
        with self._changed:
            while self._pending() and time.monotonic() < now + self._timeout and not stop.is_set():
                self._changed.wait(_POLL_PERIOD)
            late = f"no result {self._timeout:g} s after the trainer's own (training/worker_timeout)"
            for worker in self._pending():
                self._drop(worker, "" if stop.is_set() else late)
            finished = [worker for worker in self._busy if worker.result is not None]
            self._busy = []
        for worker in finished:
            worker.status.lag = max(0.0, worker.status.seen - now)
        return [worker.result for worker in finished if worker.result is not None]

    def _pending(self) -> List[RemoteWorker]:
        return [worker for worker in self._busy if worker.result is None and not worker.dropped]

    def _drop(self, worker: RemoteWorker, reason: str) -> None:
        """Continue without a worker; log the reason, if any. Call it with the lock held."""
        if reason and not (worker.dropped or self._closed):
            LOG.warning("trainer worker %d dropped: %s; training continues without it", worker.status.slot, reason)
        worker.dropped = True
        self._ready = [other for other in self._ready if other is not worker]
        self._changed.notify_all()

    def _accept_workers(self) -> None:
        admitted = 0
        while not self._closed:
            asked = self._store.add(TICKETS, 0)
            for ticket in range(max(admitted, asked - _MAX_JOINING) + 1, asked + 1):
                threading.Thread(target=self._run_worker, args=(ticket,), daemon=True).start()
            admitted = asked
            time.sleep(_POLL_PERIOD)

    def _run_worker(self, ticket: int) -> None:
        """Form a group with a worker, and exchange messages with it until it is dropped."""
        try:
            # A connection of its own: others would wait while this one waits for the worker's address.
            link = Link(connect_store(self.address), ticket_name(ticket), OWNER, self._host)
        except LinkError as error:
            LOG.warning("a trainer worker could not join: %s", error)
            return
        with self._changed:
            taken = {worker.status.slot for worker in self._workers}
            slot = next(slot for slot in range(1, len(taken) + 2) if slot not in taken)
            worker = RemoteWorker(link, slot, LINK_TIMEOUT_FACTOR * self._timeout)
            self._workers.append(worker)
        try:
            while worker.send_observations(self._observations, len(self._observations)) and not self._closed:
                pass
            LOG.info("trainer worker %d joined", slot)
            with self._changed:
                self._ready.append(worker)
                self._changed.notify_all()
            while self._step(worker):
                pass
        except LinkError as error:
            with self._changed:
                self._drop(worker, str(error))
        with self._changed:
            self._workers.remove(worker)
        link.close()

    def _step(self, worker: RemoteWorker) -> bool:
        """Exchange one message. Return False if the worker is dropped or the pool closed."""
        with self._changed:
            self._changed.wait_for(lambda: worker.task or worker.dropped or self._closed, _IDLE_PERIOD)
            if worker.dropped or self._closed:
                return False
            task = worker.task
        if task is None:
            worker.ping()
            return True
        while worker.send_observations(self._observations, task.observations):
            pass
        result = worker.make_updates(task)
        with self._changed:
            worker.task, worker.result = None, result
            self._changed.notify_all()
        return True
