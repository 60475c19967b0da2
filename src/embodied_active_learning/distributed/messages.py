"""What the owner sends to a worker, and the response. A message is a header, followed by the tensors listed here.

IDLE: none. OBSERVATIONS: states (n, D) float32 normalised, images (n, H, W, 3) uint8. ROUND: weights (P,) float32, and,
if the header says so, moments (2 P + 1,) float32.

The response to each message is the number of updates made, (1,) float64; to a ROUND, weights (P,) float32 follow.
"""

from __future__ import annotations

from typing import NamedTuple, get_type_hints

import torch

IDLE, OBSERVATIONS, ROUND = 0, 1, 2

TICKETS, CONFIG = "tickets", "config"
"""Keys of the store: number of workers that have asked to join, and the configuration as JSON."""


class Header(NamedTuple):
    """A header; as a float64 tensor with one number per field, which holds whole numbers up to 2^53."""

    kind: int
    observations: int = 0  # in the message
    start: int = 0  # number of the worker's first update
    end: int = 0  # updates from this number on are not part of the round
    step: int = 1  # between the numbers of two updates of one worker: the number of trainers
    slot: int = 0  # number of the worker, which chooses its draws
    rollbacks: int = 0  # also chooses its draws
    with_moments: int = 0
    beta: float = 0.0
    gamma: float = 0.0

    @property
    def updates(self) -> range:
        """Numbers of the updates of a round."""
        return range(self.start, self.end, self.step)

    def tensor(self) -> torch.Tensor:
        """Return the header as a tensor."""
        return torch.tensor(self, dtype=torch.float64)

    @classmethod
    def empty(cls) -> torch.Tensor:
        """Return a tensor to receive a header into."""
        return torch.zeros(len(cls._fields), dtype=torch.float64)

    @classmethod
    def from_tensor(cls, values: torch.Tensor) -> Header:
        """Return the header in a tensor."""
        types = get_type_hints(cls).values()
        return cls(*(convert(number) for convert, number in zip(types, values.tolist())))


def empty_response() -> torch.Tensor:
    """Return the first tensor of a response, with no updates made."""
    return torch.zeros(1, dtype=torch.float64)


def ticket_name(ticket: int) -> str:
    """Return the name of the group of the worker with this ticket."""
    return f"worker/{ticket}"
