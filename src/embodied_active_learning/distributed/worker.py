"""The worker's side: joins the owner and makes its share of each round."""

from __future__ import annotations

import json
import logging
import sys
import threading
from typing import Any, Callable, Optional

import numpy as np
import torch

from embodied_active_learning.config import Config
from embodied_active_learning.distributed.link import LINK_TIMEOUT_FACTOR, WORKER, Link, LinkError, connect_store
from embodied_active_learning.distributed.messages import (
    CONFIG,
    OBSERVATIONS,
    ROUND,
    TICKETS,
    Header,
    empty_response,
    ticket_name,
)
from embodied_active_learning.errors import DivergenceError
from embodied_active_learning.model.build import set_threads
from embodied_active_learning.model.learner import Learner

LOG = logging.getLogger(__name__)


class MemoryStore:
    """Observations in memory (see model.batches.ObservationSource)."""

    def __init__(self, config: Config) -> None:
        shape = (config.camera.height, config.camera.width, 3)
        capacity = config.exploration.steps
        self._states: np.ndarray = np.empty((capacity, config.workspace.box().size), np.float32)
        self._images: np.ndarray = np.empty((capacity, *shape), np.uint8)  # memory is provided as it is filled
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def states(self) -> np.ndarray:
        """(N, D) float32, normalised."""
        return self._states[: self._count]

    @property
    def images(self) -> np.ndarray:
        """(N, H, W, 3) uint8."""
        return self._images[: self._count]

    def receive(self, link: Link, count: int, timeout: float) -> None:
        """Receive the next observations. Raises LinkError, also if there is no room for them."""
        end = self._count + count
        if not 0 <= count <= len(self._states) - self._count:
            raise LinkError(f"invalid message: {count} observations after {self._count} of {len(self._states)}")
        states, images = self._states[self._count : end], self._images[self._count : end]
        link.receive(torch.from_numpy(states), torch.from_numpy(images)).wait(timeout)
        self._count = end


class TrainerWorker:
    """Trains for one owner, until that ends or the link fails."""

    def __init__(self, owner: str, address: str) -> None:
        """Join an owner.

        Args:
            owner: Where it accepts workers, as "host:port".
            address: Of this computer, as the owner reaches it.

        Raises:
            LinkError: The owner is not there.
            ConfigError: The owner's configuration is not one of this version, or the device is not usable.
        """
        store = connect_store(owner)
        config = Config.from_dict(
            json.loads(_request(lambda: store.get(CONFIG))), f"configuration of the trainer at {owner}"
        )
        set_threads(config)
        self._timeout = LINK_TIMEOUT_FACTOR * config.training.worker_timeout
        self._store = MemoryStore(config)
        self._learner = Learner(config, self._store, config.exploration.seed)
        torch.set_num_threads(self._learner.loss.torch_threads)
        # Last, because the owner then waits for responses.
        self._link = Link(store, ticket_name(_request(lambda: store.add(TICKETS, 1))), WORKER, address)
        self._weights = self._learner.weights()
        self._header = Header.empty()
        self.rounds = 0

    @property
    def observations(self) -> int:
        """Number of observations received."""
        return len(self._store)

    def run(self, stop: threading.Event) -> None:
        """Train until stop is set, which is checked after each message. Raises LinkError if the owner is lost."""
        try:
            while not stop.is_set():
                self._handle_message()
        finally:
            self._link.close()

    def _handle_message(self) -> None:
        self._link.receive(self._header).wait(self._timeout)
        header, response = Header.from_tensor(self._header), empty_response()
        if header.kind == OBSERVATIONS:
            self._store.receive(self._link, header.observations, self._timeout)
        if header.kind == ROUND:
            response[0] = self._train(header)
            self._link.send(response, self._weights).wait(self._timeout)
        else:
            self._link.send(response).wait(self._timeout)

    def _train(self, header: Header) -> int:
        """Make this worker's updates of a round and return their number. The weights are then in self._weights."""
        learner = self._learner
        self._link.receive(self._weights).wait(self._timeout)
        learner.load_weights(self._weights)
        if header.with_moments:
            moments = torch.zeros_like(learner.moments())
            self._link.receive(moments).wait(self._timeout)
            learner.load_moments(moments)
        learner.reseed(header.slot, header.start, header.rollbacks)
        made = self._make_updates(header)
        if made:
            self._weights = learner.weights()
        self.rounds += 1
        return made

    def _make_updates(self, header: Header) -> int:
        """Return the number of updates made: none if the model diverges, which the owner then meets as well."""
        for number in header.updates:
            try:
                self._learner.step(number, header.beta, header.gamma)
            except DivergenceError as error:
                LOG.warning("%s; this worker's updates of the round are discarded", error)
                return 0
        return len(header.updates)


def _request(request: Callable[[], Any]) -> Any:
    """Return the response of the store. Raises LinkError if it does not respond."""
    try:
        return request()
    except RuntimeError as error:
        raise LinkError(f"the trainer does not respond: {error}") from error


def serve(
    find_owner: Callable[[], str],
    address: str,
    stop: threading.Event,
    on_join: Callable[[Optional[TrainerWorker]], None] = lambda worker: None,
    retry_period: float = 1.0,
) -> None:
    """Train for the owner, joining again after each failure, until stop is set.

    Args:
        find_owner: Returns the owner's address "host:port". Raises LinkError if it is not known.
        address: Of this computer, as the owner reaches it.
        stop: Ends this function.
        on_join: Called with the worker when it has joined, and with None when it has lost its owner.
        retry_period: Between two attempts [s].

    Raises:
        ConfigError: As TrainerWorker.
    """
    reported = ""
    while not stop.is_set():
        try:
            owner = find_owner()
            worker = TrainerWorker(owner, address)
            LOG.info("joined the trainer at %s", owner)
            on_join(worker)
            reported = ""
            worker.run(stop)
        except LinkError as error:
            on_join(None)
            if str(error) != reported:
                LOG.warning("not connected to a trainer: %s; retrying every %g s", error, retry_period)
            reported = str(error)
            stop.wait(retry_period)


def serve_until_end(owner: str, address: str) -> None:
    """Train for the owner at "host:port" until that has ended. address: of this computer."""
    stop = threading.Event()

    def find_owner() -> str:
        try:
            connect_store(owner)
        except LinkError:
            stop.set()
            raise
        return owner

    serve(find_owner, address, stop, retry_period=0.1)


if __name__ == "__main__":
    serve_until_end(*sys.argv[1:])
