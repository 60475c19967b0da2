"""The parts of a learner, made for a configuration and for the machine that it runs on."""

from __future__ import annotations

import torch

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ConfigError
from embodied_active_learning.model.cvae import ConditionalVAE, initialise
from embodied_active_learning.model.fast import fastest_loss
from embodied_active_learning.model.inference import InferenceImages, TorchImages, fastest_images
from embodied_active_learning.model.objective import Arithmetic, plain_loss


def choose_device(name: str) -> torch.device:
    """The device for "auto", "cpu" or "cuda". Raises ConfigError for cuda where there is none."""
    available = torch.cuda.is_available()
    if name == "cuda" and not available:
        raise ConfigError("training/device is 'cuda' but torch sees no CUDA device here: use auto or cpu")
    return torch.device("cuda" if available and name != "cpu" else "cpu")


def choose_arithmetic(network: ConditionalVAE, device: torch.device) -> Arithmetic:
    """The fastest way to compute the loss on the device.

    On CUDA, where all convolutions of this process are set to be exact and deterministic.
    """
    if device.type == "cpu":
        return fastest_loss(network)
    if device.type == "cuda":
        # By default some gradients of convolutions are summed in any order, and factors are rounded to 10 bits.
        torch.backends.cudnn.deterministic = True
        torch.backends.cudnn.benchmark = False
        torch.backends.cudnn.allow_tf32 = False
    return Arithmetic(plain_loss, f"torch on {device}", torch.get_num_threads())


def choose_images(config: Config, device: torch.device) -> InferenceImages:
    """The fastest way to ask the network on the device."""
    if device.type == "cpu":
        return fastest_images((config.camera.height, config.camera.width), config.model)
    return TorchImages()


def build_network(config: Config, seed: int) -> ConditionalVAE:
    """The network of a run, initialised from the seed alone; on the CPU."""
    # Made without memory first: the layers' own initialisation would draw from torch's global generator.
    with torch.device("meta"):
        image_size = (config.camera.height, config.camera.width)
        network = ConditionalVAE(image_size, config.workspace.box().size, config.model)
    network = network.to_empty(device="cpu")
    initialise(network, torch.Generator().manual_seed(seed))
    return network
