"""Builds the parts of a learner for a configuration and a device."""

from __future__ import annotations

import logging

import torch
from torch.nn import functional

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ConfigError
from embodied_active_learning.model.cvae import ConditionalVAE, initialise
from embodied_active_learning.model.inference import Inference, TorchInference, make_inference
from embodied_active_learning.model.loss import LossFunction, PlainLoss
from embodied_active_learning.model.native.library import load_kernels
from embodied_active_learning.model.native.loss import NativeLoss

LOG = logging.getLogger(__name__)


def choose_device(name: str) -> torch.device:
    """Return the device for "auto", "cpu" or "cuda"; "auto" takes a GPU that works, else the CPU.

    Raises:
        ConfigError: "cuda" was requested, and torch cannot compute on a GPU here.
    """
    if name == "cpu":
        return torch.device("cpu")
    if not torch.cuda.is_available():
        if name == "cuda":
            raise ConfigError("no CUDA device: torch finds none; set training/device: cpu")
        return torch.device("cpu")
    try:
        check_device(torch.device("cuda"))
    except RuntimeError as error:
        reason = str(error).strip().partition("\n")[0]
        if name == "cuda":
            raise ConfigError(f"CUDA device unusable: {reason}; set training/device: cpu") from error
        LOG.warning("CUDA device unusable: %s; training on the CPU (training/device: cpu avoids this check)", reason)
        return torch.device("cpu")
    return torch.device("cuda")


def set_threads(config: Config) -> None:
    """Set the number of threads of this process: training/threads, or this trainer's share of the cores."""
    training = config.training
    if training.threads:
        torch.set_num_threads(training.threads)
    elif training.trainers > 1:
        torch.set_num_threads(max(1, torch.get_num_threads() // training.trainers))


def check_device(device: torch.device) -> None:
    """Compute a small convolution and its gradient on a device.

    Raises:
        RuntimeError: The device exists but cannot compute, for example because torch has no kernels for it.
    """
    weight = torch.ones((1, 1, 3, 3), device=device, requires_grad=True)
    functional.conv2d(torch.ones((1, 1, 8, 8), device=device), weight, stride=2).sum().backward()
    gradient = weight.grad
    if gradient is None or not bool((gradient.cpu() == 9.0).all()):
        raise RuntimeError(f"wrong gradient of a convolution on {device}")


def choose_loss(network: ConditionalVAE, device: torch.device) -> LossFunction:
    """Return the fastest loss function on the device.

    On CUDA, all convolutions of this process become deterministic and exact.
    """
    if device.type == "cpu":
        kernels, description = load_kernels()
        return NativeLoss(network, kernels, description) if kernels else PlainLoss(description)
    if device.type == "cuda":
        # By default, some gradients are summed in any order, and factors are rounded to 10 bits (TF32).
        torch.backends.cudnn.deterministic = True
        torch.backends.cudnn.benchmark = False
        torch.backends.cudnn.allow_tf32 = False
    return PlainLoss(f"plain network on {device}")


def choose_inference(config: Config, device: torch.device) -> Inference:
    """Return the fastest inference on the device."""
    if device.type == "cpu":
        return make_inference((config.camera.height, config.camera.width), config.model)
    return TorchInference()


def build_network(config: Config, seed: int) -> ConditionalVAE:
    """Return the network of a run on the CPU, initialised from the seed alone."""
    # Built without memory first: the layers' own initialisation would draw from torch's global generator.
    with torch.device("meta"):
        image_size = (config.camera.height, config.camera.width)
        network = ConditionalVAE(image_size, config.workspace.box().size, config.model)
    network = network.to_empty(device="cpu")
    initialise(network, torch.Generator().manual_seed(seed))
    return network
