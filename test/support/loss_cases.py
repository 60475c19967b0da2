"""Random networks and batches for tests of the loss."""

import torch

from embodied_active_learning.model.cvae import ConditionalVAE
from embodied_active_learning.model.loss import Batch


def make_case(image_size, config, size, dtype=torch.float32):
    """A network, a pair of batches of `size` observations each, and noise."""
    torch.manual_seed(0)
    network = ConditionalVAE(image_size, 3, config).to(dtype)
    images = torch.randint(0, 256, (2 * size, *image_size, 3), dtype=torch.uint8)
    pair = Batch((torch.rand(2 * size, 3) * 2 - 1).to(dtype), images)
    return network, pair, torch.randn(size, config.latent_size).to(dtype)
