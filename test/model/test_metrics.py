"""Active units, reconstruction errors, and the reader of observations."""

import numpy as np
import pytest
import torch

from embodied_active_learning.config import ModelConfig
from embodied_active_learning.model.batches import BatchReader
from embodied_active_learning.model.cvae import ConditionalVAE
from embodied_active_learning.model.inference import TorchInference, make_inference
from embodied_active_learning.model.loss import Batch
from embodied_active_learning.model.metrics import active_units, evaluate_model, reconstruction_error


def test_active_units_use_the_unbiased_variance():
    # variances 0.0128 (0.0064 with N in the denominator), 0 and 0.005
    means = torch.tensor([[0.0, 5.0, 0.0], [0.16, 5.0, 0.1]])
    assert active_units(means) == 1


@pytest.mark.parametrize("inference", [TorchInference(), make_inference((45, 45), ModelConfig())])
@pytest.mark.parametrize("count", [7, 70])
def test_reconstruction_errors_are_mean_squared_pixel_errors(inference, count):
    torch.manual_seed(0)
    network = ConditionalVAE((45, 45), 3, ModelConfig())
    subset = Batch(torch.rand(count, 3), torch.randint(0, 256, (count, 45, 45, 3), dtype=torch.uint8))
    with torch.no_grad():
        latents = network.encode(*subset).mean
        _, found = evaluate_model(network, inference, subset)
        for name, used in (("own", latents), ("shuffled", latents.roll(1, dims=0)), ("none", 0.0 * latents)):
            images, _ = network.decode(used, subset.states)
            expected = np.mean((subset.images.numpy() / 255.0 - images.permute(0, 2, 3, 1).numpy()) ** 2)
            assert abs(getattr(found, name) - expected) < 1e-6
            assert abs(reconstruction_error(network, inference, used, subset) - expected) < 1e-6


def test_reader_extends_its_device_cache_as_the_store_grows():
    class Store:
        states = np.zeros((300, 3), np.float32)
        images = np.random.default_rng(0).integers(0, 256, (300, 5, 5, 3), dtype=np.uint8)
        count = 10

        def __len__(self):
            return self.count

    store = Store()
    reader = BatchReader(store, torch.device("cpu"))
    reader._copies = True  # as on a GPU
    for store.count in (10, 200, 300):
        indices = np.array([0, 7, store.count - 1])
        assert np.array_equal(reader.read(indices).images.numpy(), store.images[indices])
