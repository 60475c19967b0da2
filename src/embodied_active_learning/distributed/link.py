"""Connection of the owner and a worker: a Gloo process group of two members that carries tensors."""

from __future__ import annotations

import re
import socket
import time
from datetime import timedelta
from typing import Any, Iterable, List, Tuple

import torch
from torch import distributed

from embodied_active_learning.errors import EmbodiedActiveLearningError

OWNER, WORKER = 0, 1  # ranks
JOIN_TIMEOUT = 20.0  # s, for forming a group
LINK_TIMEOUT_FACTOR = 4.0  # times training/worker_timeout without a message, after which either side gives up the link


class LinkError(EmbodiedActiveLearningError):
    """The other process has ended, does not respond, or cannot be reached."""


class Transfer:
    """Tensors that are being sent or received; keeps their memory until it is dropped."""

    def __init__(self, works: Iterable[Tuple[Any, torch.Tensor]]) -> None:
        self._works = list(works)

    def wait(self, timeout: float) -> None:
        """Wait until all are transferred. Raises LinkError after the timeout [s], and if the link fails."""
        ends_at = time.monotonic() + timeout
        for work, _ in self._works:
            left = max(0.001, ends_at - time.monotonic())  # Gloo waits without limit for 0
            try:
                work.wait(timedelta(seconds=left))
            except RuntimeError as error:
                raise LinkError(_reason(error)) from error


class Link:
    """A process group of owner and worker. After a LinkError it cannot be used any more: close it.

    Attributes:
        bytes: Number of bytes posted for sending or receiving.
    """

    def __init__(self, store: distributed.Store, name: str, rank: int, address: str) -> None:
        """Form the group. Both processes call this at about the same time.

        Args:
            store: Where the two exchange their addresses.
            name: Of the group; unique in the store.
            rank: OWNER or WORKER.
            address: Of this computer; the only one that the group listens on.

        Raises:
            LinkError: The other process is not there, or cannot be reached.
        """
        gloo: Any = distributed.ProcessGroupGloo
        options = gloo._Options()  # the only way to choose an address; the environment chooses an interface by name
        options._timeout = timedelta(seconds=JOIN_TIMEOUT)
        options._threads = 1
        self._peer = WORKER if rank == OWNER else OWNER
        self.bytes = 0
        try:
            options._devices = [gloo.create_device(hostname=address)]
            self._group: Any = gloo(distributed.PrefixStore(name, store), rank, 2, options)
        except RuntimeError as error:
            raise LinkError(f"no link between trainers: {_reason(error)}") from error

    def send(self, *tensors: torch.Tensor) -> Transfer:
        """Begin to send contiguous CPU tensors, which must not be changed before the transfer is complete."""
        return self._post(self._group.send, tensors)

    def receive(self, *tensors: torch.Tensor) -> Transfer:
        """Begin to receive into contiguous CPU tensors of the shapes and types that the other process sends."""
        return self._post(self._group.recv, tensors)

    def close(self) -> None:
        """Close the connection, which the other process notices. The link cannot be used afterwards."""
        self._group = None

    def _post(self, operation: Any, tensors: Iterable[torch.Tensor]) -> Transfer:
        works: List[Tuple[Any, torch.Tensor]] = []
        for tensor in tensors:
            try:
                works.append((operation([tensor], self._peer, 0), tensor))
            except RuntimeError as error:
                raise LinkError(_reason(error)) from error
            self.bytes += tensor.numel() * tensor.element_size()
        return Transfer(works)


def serve_store(address: str) -> Tuple[distributed.TCPStore, int]:
    """Start a store that listens on one address; return store and port. Raises LinkError if that is not possible."""
    try:
        family, kind, protocol, _, where = socket.getaddrinfo(address, 0, type=socket.SOCK_STREAM)[0]
        listening = socket.socket(family, kind, protocol)
        listening.bind(where)
    except OSError as error:
        raise LinkError(
            f"trainers cannot listen on {address} ({error.strerror}): check ROS_IP or ROS_HOSTNAME"
        ) from error
    listening.listen(128)
    port = int(listening.getsockname()[1])
    # A store that opened the port itself would listen on all addresses. It closes this one at its end.
    return _store(address, port, is_master=True, master_listen_fd=listening.detach()), port


def connect_store(address: str) -> distributed.TCPStore:
    """Connect to the store at "host:port". Raises LinkError if it is not there."""
    host, _, port = address.rpartition(":")
    if not host or not port.isdigit():
        raise LinkError(f"invalid address of the trainer {address!r}: expected host:port")
    try:
        # torch repeats its attempts noisily until its timeout; a plain attempt fails at once.
        socket.create_connection((host, int(port)), JOIN_TIMEOUT).close()
        return _store(host, int(port), is_master=False)
    except (OSError, RuntimeError) as error:
        raise LinkError(f"no trainer at {address}: {_reason(error)}") from error


def _store(host: str, port: int, **options: Any) -> distributed.TCPStore:
    timeout = timedelta(seconds=JOIN_TIMEOUT)
    # torch 2.4's default, libuv, accepts no socket that listens already.
    return distributed.TCPStore(host, port, timeout=timeout, wait_for_workers=False, use_libuv=False, **options)


def _reason(error: Exception) -> str:
    """Return the first sentence of an error of torch, without the line of its source code."""
    return re.sub(r"^\[\S+\] ", "", str(error).strip()).partition(". ")[0].partition("\n")[0]
