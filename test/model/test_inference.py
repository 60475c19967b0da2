"""Inference on torch and on the compiled kernels gives what the network gives."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch

from embodied_active_learning.config import ModelConfig
from embodied_active_learning.model import inference
from embodied_active_learning.model.cvae import ConditionalVAE
from embodied_active_learning.model.inference import NativeInference, TorchInference, make_inference
from embodied_active_learning.model.native.library import LoadedKernels, load_kernels

KERNELS, DESCRIPTION = load_kernels()
needs_kernels = pytest.mark.skipif(KERNELS is None, reason=DESCRIPTION)
GEOMETRIES = [
    ((45, 45), ModelConfig()),
    ((44, 61), ModelConfig(channels=(4, 6), kernels=(4, 3), strides=(3, 3))),
    ((30, 41), ModelConfig(channels=(4,), kernels=(5,), strides=(2,))),
]

CASES = pytest.mark.parametrize(
    ("image_size", "config", "count"),
    [(*GEOMETRIES[0], 1), (*GEOMETRIES[0], 70), (*GEOMETRIES[1], 5), (*GEOMETRIES[2], 16)],
)


@pytest.fixture(autouse=True)
def _empty_cache():
    """Each test builds its own inference."""
    inference._make_inference.cache_clear()
    yield
    inference._make_inference.cache_clear()


def make(image_size, config, count, seed=0):
    """A network of strong colours, images and features."""
    torch.manual_seed(seed)
    network = ConditionalVAE(image_size, 3, config).requires_grad_(False)
    network.image_decoder[-1].weight.mul_(30.0)
    features = 3.0 * torch.randn(count, network.feature_size)
    return network, torch.randint(0, 256, (count, *image_size, 3), dtype=torch.uint8), features


def of_network(network, images, features):
    decoded = network.image_decoder(features.unflatten(1, network.feature_shape))
    return network.image_features(images), decoded.permute(0, 2, 3, 1)


def outputs(tested, network, images, features):
    return tested.encode(network, images), tested.decode(network, features)


def assert_matches_network(tested, network, images, features):
    expected = of_network(network, images, features)
    for found, wanted in zip(outputs(tested, network, images, features), expected):
        torch.testing.assert_close(found, wanted, rtol=1e-5, atol=1e-4)


@CASES
def test_torch_inference_matches_network(image_size, config, count):
    assert_matches_network(TorchInference(), *make(image_size, config, count))


@needs_kernels
@CASES
def test_native_inference_matches_network(image_size, config, count):
    tested = make_inference(image_size, config)
    assert isinstance(tested, NativeInference)
    assert_matches_network(tested, *make(image_size, config, count))


@needs_kernels
def test_native_inference_matches_network_at_180_pixels():
    assert_matches_network(make_inference((180, 180), ModelConfig()), *make((180, 180), ModelConfig(), 20))


@pytest.mark.parametrize("tested", [TorchInference(), make_inference(*GEOMETRIES[0])])
def test_lists_of_images_are_encoded_like_a_tensor(tested):
    network, images, _ = make(*GEOMETRIES[0], 70)
    assert torch.equal(tested.encode(network, list(images)), tested.encode(network, images))


@needs_kernels
def test_networks_of_one_geometry_share_only_inference():
    tested = make_inference(*GEOMETRIES[0])
    assert make_inference(*GEOMETRIES[0]) is tested
    assert make_inference(*GEOMETRIES[1]) is not tested
    for seed in (0, 1, 0):
        assert_matches_network(tested, *make(*GEOMETRIES[0], 20, seed))


@needs_kernels
def test_native_inference_is_thread_safe():
    tested = make_inference(*GEOMETRIES[0])
    queries = [make(*GEOMETRIES[0], 40, seed) for seed in range(6)]
    with ThreadPoolExecutor(6) as pool:
        found = list(pool.map(lambda query: outputs(tested, *query), 5 * queries))
    expected = [outputs(tested, *query) for query in queries]
    for index, both in enumerate(found):
        assert all(torch.equal(*pair) for pair in zip(both, expected[index % 6]))


def test_torch_inference_splits_many_images_into_chunks():
    network, images, features = make(*GEOMETRIES[0], 150)
    sizes = []
    for part in (network.image_encoder, network.image_decoder):
        part.register_forward_hook(lambda _, inputs, __: sizes.append(len(inputs[0])))
    outputs(TorchInference(), network, images, features)
    assert sizes == [64, 64, 22] * 2


@needs_kernels
def test_nan_weight_gives_nan_outputs():
    network, images, features = make(*GEOMETRIES[0], 3)
    network.image_encoder[0].bias[0] = network.image_decoder[-1].bias[0] = math.nan
    tested = make_inference(*GEOMETRIES[0])
    assert all(found.isnan().any() for found in outputs(tested, network, images, features))


def test_torch_inference_is_used_without_kernels(monkeypatch):
    monkeypatch.setattr(inference, "load_kernels", lambda: LoadedKernels(None, "not compiled"))
    assert isinstance(make_inference(*GEOMETRIES[0]), TorchInference)


@needs_kernels
def test_inference_follows_torchs_number_of_threads():
    before = torch.get_num_threads()
    first = make_inference(*GEOMETRIES[0])
    try:
        torch.set_num_threads(before + 1)
        assert make_inference(*GEOMETRIES[0]).convolutions.threads == before + 1
    finally:
        torch.set_num_threads(before)
    assert make_inference(*GEOMETRIES[0]) is first


@needs_kernels
def test_native_linear_layer_works_in_inference_mode():
    network, _, _ = make((45, 45), ModelConfig(), 1)
    tested = make_inference((45, 45), ModelConfig())
    inputs = torch.randn(3, network.decoder[-1].in_features)
    with torch.inference_mode():
        for _ in range(20):  # on whichever thread
            assert torch.allclose(tested.linear(network.decoder[-1], inputs), network.decoder[-1](inputs), atol=1e-5)
