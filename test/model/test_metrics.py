"""Active units, reconstruction errors, and the reader of observations."""

import platform
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from embodied_active_learning.config import ModelConfig
from embodied_active_learning.model import allocator
from embodied_active_learning.model.batches import BatchReader
from embodied_active_learning.model.cvae import ConditionalVAE
from embodied_active_learning.model.inference import TorchInference, make_inference
from embodied_active_learning.model.metrics import active_units, evaluate_model, reconstruction_error
from embodied_active_learning.model.objective import Batch


def test_active_units_use_the_unbiased_variance():
    # variances 0.02 (0.01 with N in the denominator), 0 and 0.005
    means = torch.tensor([[0.0, 5.0, 0.0], [0.2, 5.0, 0.1]])
    assert active_units(means, 0.015) == 1
    assert active_units(means, 0.004) == 2


@pytest.mark.parametrize("inference", [TorchInference(), make_inference((45, 45), ModelConfig())])
@pytest.mark.parametrize("count", [7, 70])
def test_reconstruction_errors_are_mean_squared_pixel_errors(inference, count):
    torch.manual_seed(0)
    network = ConditionalVAE((45, 45), 3, ModelConfig())
    subset = Batch(torch.rand(count, 3), torch.randint(0, 256, (count, 45, 45, 3), dtype=torch.uint8))
    with torch.no_grad():
        latents = network.encode(*subset).mean
        found = evaluate_model(network, inference, subset, 0.01)
        for name, used in (("own", latents), ("shuffled", latents.roll(1, dims=0)), ("none", 0.0 * latents)):
            images, _ = network.decode(used, subset.states)
            expected = np.mean((subset.images.numpy() / 255.0 - images.permute(0, 2, 3, 1).numpy()) ** 2)
            assert abs(found[f"mse_{name}"] - expected) < 1e-6
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


@pytest.mark.parametrize(
    ("largest_mmap_threshold", "others", "all_of_them"),
    [(2**31, True, True), (2**25, True, True), (2**24, True, False), (2**31, False, False)],
)
def test_freed_memory_is_kept_as_far_as_the_c_library_goes(monkeypatch, largest_mmap_threshold, others, all_of_them):
    switched = set()

    def mallopt(switch, value):
        accepted = value <= largest_mmap_threshold if switch == allocator.M_MMAP_THRESHOLD else others
        switched.update({switch} if accepted else ())
        return int(accepted)

    monkeypatch.setattr(allocator.ctypes, "CDLL", lambda _: SimpleNamespace(mallopt=mallopt))
    assert allocator.keep_freed_memory() is all_of_them
    assert ({allocator.M_TRIM_THRESHOLD, allocator.M_ARENA_MAX} <= switched) is others
    assert (allocator.M_MMAP_THRESHOLD in switched) is (largest_mmap_threshold >= 2**25)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries have no such switch")
def test_what_a_thread_frees_is_kept_too():
    program = """
import resource, threading
import numpy as np
from embodied_active_learning.model.allocator import keep_freed_memory

assert keep_freed_memory()
faults = []

def work():
    for _ in range(4):
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        np.ones(2**27, np.uint8)  # 64 huge pages, or 2**15 small ones
        faults.append(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)

thread = threading.Thread(target=work)
thread.start()
thread.join()
print(faults[-1])
"""
    ended = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    assert int(ended.stdout) < 32


def test_without_the_switches_freed_memory_is_left_to_the_c_library(monkeypatch):
    monkeypatch.setattr(allocator.ctypes, "CDLL", lambda _: SimpleNamespace())
    assert allocator.keep_freed_memory() is False
