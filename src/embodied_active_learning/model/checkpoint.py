"""Network and optimiser as one flat dictionary of tensors, and back."""

from __future__ import annotations

from typing import Any, Dict, Iterable, Mapping

import torch

from embodied_active_learning.errors import ConfigError, CorruptFileError
from embodied_active_learning.model.cvae import ConditionalVAE
from embodied_active_learning.model.optimiser import Optimiser

MOMENTS = ("exp_avg", "exp_avg_sq")
NETWORK = "network/"
EARLIER = "earlier/"


def network_weights(tensors: Mapping[str, torch.Tensor]) -> Dict[str, torch.Tensor]:
    """The network's weights among packed tensors, by the network's own names."""
    return _unprefixed(tensors, NETWORK)


def earlier_weights(tensors: Mapping[str, torch.Tensor], network: ConditionalVAE) -> Dict[str, torch.Tensor]:
    """The weights of an earlier model among packed tensors, by the network's own names; empty when there are none.

    Raises ConfigError naming a tensor of another shape, CorruptFileError a missing one.
    """
    found = _unprefixed(tensors, EARLIER)
    if found:
        _check(found, dict(network.named_parameters()))
    return found


def pack_earlier(weights: Mapping[str, torch.Tensor]) -> Dict[str, torch.Tensor]:
    """Copies of an earlier model's weights ("earlier/..."), on the CPU."""
    return {f"{EARLIER}{name}": _copy(tensor) for name, tensor in weights.items()}


def pack(network: ConditionalVAE, optimiser: Optimiser) -> Dict[str, torch.Tensor]:
    """Copies of the weights ("network/..."), Adam's moments ("adam/<moment>/...") and its step count, on the CPU."""
    tensors = {"adam/step": torch.zeros(())}
    state = optimiser.state
    for name, parameter in network.named_parameters():
        tensors[f"{NETWORK}{name}"] = _copy(parameter)
        moments = state.get(parameter, {})
        for moment in MOMENTS:
            tensors[f"adam/{moment}/{name}"] = _copy(moments.get(moment, torch.zeros_like(parameter)))
        tensors["adam/step"] = _copy(moments.get("step", tensors["adam/step"]))
    return tensors


def unpack(tensors: Mapping[str, torch.Tensor], network: ConditionalVAE, optimiser: Optimiser) -> None:
    """Put packed tensors back. Raises ConfigError naming a tensor of another shape, CorruptFileError a missing one."""
    _check(tensors, pack(network, optimiser))
    names = {parameter: name for name, parameter in network.named_parameters()}
    network.load_state_dict({name: tensors[f"{NETWORK}{name}"] for name in names.values()})
    for part in optimiser.parts:
        groups = part.state_dict()["param_groups"]
        own = [names[parameter] for group in part.param_groups for parameter in group["params"]]
        moments = [{moment: tensors[f"adam/{moment}/{name}"].clone() for moment in MOMENTS} for name in own]
        state = {index: {"step": tensors["adam/step"].clone(), **pair} for index, pair in enumerate(moments)}
        part.load_state_dict({"state": state, "param_groups": groups})


def require(found: Mapping[str, Any], keys: Iterable[str]) -> None:
    """Raise CorruptFileError naming the first key that is not found."""
    for key in keys:
        if key not in found:
            raise CorruptFileError(
                f"checkpoint lacks {key}: it was not written by this version of the package; delete it"
            )


def _check(tensors: Mapping[str, torch.Tensor], expected: Mapping[str, torch.Tensor]) -> None:
    require(tensors, expected)
    for key, tensor in expected.items():
        if tensors[key].shape != tensor.shape:
            raise ConfigError(
                f"checkpoint holds {key} as {tuple(tensors[key].shape)}, this configuration makes it"
                f" {tuple(tensor.shape)}: use the configuration that the session was recorded with"
            )


def _unprefixed(tensors: Mapping[str, torch.Tensor], prefix: str) -> Dict[str, torch.Tensor]:
    return {key[len(prefix) :]: tensor for key, tensor in tensors.items() if key.startswith(prefix)}


def _copy(tensor: torch.Tensor) -> torch.Tensor:
    return tensor.detach().to("cpu", copy=True).contiguous()
