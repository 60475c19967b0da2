"""Adam, taking its step while the next batch is already being looked at."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Callable, Dict, Iterable, List

import torch
from torch import nn

from embodied_active_learning.model.cvae import ConditionalVAE


class Optimiser:
    """Adam as the paper has it: the image encoder's weights are stepped at once, all others in the background.

    Adam waits for memory and keeps the processor idle, which the convolutions of the next batch do not. Who reads other
    weights than the image encoder's, or changes any weight or gradient, calls settle() first. One thread may call the
    methods.
    """

    def __init__(self, network: ConditionalVAE, learning_rate: float) -> None:
        first = list(network.image_encoder.parameters())
        known = {id(parameter) for parameter in first}
        others = [parameter for parameter in network.parameters() if id(parameter) not in known]
        self.parts = [_adam(part, learning_rate) for part in (first, others)]
        # A unit that is dead for some hundred updates has moments below 1e-38, with which processors are slow; as zeros
        # they change no weight.
        self._background = ThreadPoolExecutor(1, "adam", torch.set_flush_denormal, (True,))
        self._pending: List[Future] = []

    @property
    def state(self) -> Dict[nn.Parameter, Dict[str, torch.Tensor]]:
        """Adam's moments and step count of each parameter that has been stepped."""
        return {parameter: state for part in self.parts for parameter, state in part.state.items()}

    def step(self) -> None:
        """Take a step from the gradients that the parameters have."""
        self.settle()
        first, others = self.parts
        first.step()
        self.afterwards(others.step)

    def afterwards(self, task: Callable[[], None]) -> None:
        """Have a task done in the background, behind the step that is being taken; not if that fails."""
        before = tuple(self._pending)

        def follow() -> None:
            if all(earlier.exception() is None for earlier in before):
                task()

        self._pending.append(self._background.submit(follow))

    def settle(self) -> None:
        """Wait until the last step is taken, and what was to come afterwards is done. Raises what went wrong first."""
        pending, self._pending = self._pending, []
        wait(pending)
        for task in pending:
            task.result()


def _adam(parameters: Iterable[nn.Parameter], learning_rate: float) -> torch.optim.Adam:
    """Adam in one pass over the weights, where torch can do so."""
    chosen: List[nn.Parameter] = list(parameters)
    try:
        return torch.optim.Adam(chosen, learning_rate, fused=True)
    except RuntimeError:  # a torch without fused kernels for this device
        return torch.optim.Adam(chosen, learning_rate)
