"""Adam, whose step runs in the background while the next batch is encoded."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Callable, Dict, Iterable, List, Mapping

import torch
from torch import nn

from embodied_active_learning.model.cvae import ConditionalVAE

MOMENTS = ("exp_avg", "exp_avg_sq")


class Optimiser:
    """Adam (paper, appendix): the image encoder is stepped at once, all other weights in the background.

    Adam is limited by memory bandwidth, so the next batch's convolutions can use the processor meanwhile. Call join()
    before reading any weight but the image encoder's, or changing any weight or gradient. One thread may call the
    methods.
    """

    def __init__(self, network: ConditionalVAE, learning_rate: float) -> None:
        self._names = {parameter: name for name, parameter in network.named_parameters()}
        encoder = list(network.image_encoder.parameters())
        ids = {id(parameter) for parameter in encoder}
        others = [parameter for parameter in network.parameters() if id(parameter) not in ids]
        self.parts = [_adam(part, learning_rate) for part in (encoder, others)]
        # Units without gradient for hundreds of updates have denormal moments, which are slow; as zeros they change
        # no weight.
        self._background = ThreadPoolExecutor(1, "adam", torch.set_flush_denormal, (True,))
        self._pending: List[Future] = []

    def step(self) -> None:
        """Start a step from the parameters' gradients."""
        self.join()
        encoder, others = self.parts
        encoder.step()
        self.run_after_step(others.step)

    def run_after_step(self, task: Callable[[], None]) -> None:
        """Run a task in the background after the current step, unless that fails."""
        previous = tuple(self._pending)

        def run() -> None:
            if all(future.exception() is None for future in previous):
                task()

        self._pending.append(self._background.submit(run))

    def join(self) -> None:
        """Wait for the current step and the tasks behind it. Raises the first error among them."""
        pending, self._pending = self._pending, []
        wait(pending)
        for future in pending:
            future.result()

    def state_dict(self) -> Dict[str, torch.Tensor]:
        """Return copies of Adam's moments, "<moment>/<parameter>", and its "step" count, on the CPU."""
        state = {parameter: values for part in self.parts for parameter, values in part.state.items()}
        tensors = {"step": torch.zeros(())}
        for parameter, name in self._names.items():
            values = state.get(parameter, {})
            for moment in MOMENTS:
                tensors[f"{moment}/{name}"] = copy_to_cpu(values.get(moment, torch.zeros_like(parameter)))
            tensors["step"] = copy_to_cpu(values.get("step", tensors["step"]))
        return tensors

    def load_state_dict(self, tensors: Mapping[str, torch.Tensor]) -> None:
        """Restore state_dict()."""
        for part in self.parts:
            groups = part.state_dict()["param_groups"]
            names = [self._names[parameter] for group in part.param_groups for parameter in group["params"]]
            moments = [{moment: tensors[f"{moment}/{name}"].clone() for moment in MOMENTS} for name in names]
            state = {index: {"step": tensors["step"].clone(), **pair} for index, pair in enumerate(moments)}
            part.load_state_dict({"state": state, "param_groups": groups})


def copy_to_cpu(tensor: torch.Tensor) -> torch.Tensor:
    """Return a contiguous copy on the CPU."""
    return tensor.detach().to("cpu", copy=True).contiguous()


def _adam(parameters: Iterable[nn.Parameter], learning_rate: float) -> torch.optim.Adam:
    """Adam with fused kernels, if this torch has them for the device."""
    chosen: List[nn.Parameter] = list(parameters)
    try:
        return torch.optim.Adam(chosen, learning_rate, fused=True)
    except RuntimeError:
        return torch.optim.Adam(chosen, learning_rate)
