"""Asked without gradients, torch and the compiled kernels answer what the network answers."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch

from embodied_active_learning.config import ModelConfig
from embodied_active_learning.model import inference
from embodied_active_learning.model.cvae import ConditionalVAE
from embodied_active_learning.model.inference import CompiledImages, TorchImages, fastest_images
from embodied_active_learning.model.native.library import load_library

LIBRARY, REASON = load_library()
needs_compiler = pytest.mark.skipif(LIBRARY is None, reason=REASON)
GEOMETRIES = [
    ((45, 45), ModelConfig()),
    ((44, 61), ModelConfig(channels=(4, 6), kernels=(4, 3), strides=(3, 3))),
    ((30, 41), ModelConfig(channels=(4,), kernels=(5,), strides=(2,))),
]


@pytest.fixture(autouse=True)
def _nothing_kept():
    """What was made for one test, perhaps without a compiler, does not serve another one."""
    inference._fastest_images.cache_clear()
    yield
    inference._fastest_images.cache_clear()


def make(image_size, config, count, seed=0):
    """A network of strong colours, and what to ask it: images and features."""
    torch.manual_seed(seed)
    network = ConditionalVAE(image_size, 3, config).requires_grad_(False)
    network.image_decoder[-1].weight.mul_(30.0)
    features = 3.0 * torch.randn(count, network.feature_size)
    return network, torch.randint(0, 256, (count, *image_size, 3), dtype=torch.uint8), features


def of_network(network, images, features):
    decoded = network.image_decoder(features.unflatten(1, network.feature_shape))
    return network.image_features(images), decoded.permute(0, 2, 3, 1)


def answers(asked, network, images, features):
    return asked.features(network, images), asked.decode(network, features)


def assert_answers(asked, network, images, features):
    for found, expected in zip(answers(asked, network, images, features), of_network(network, images, features)):
        torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize(("image_size", "config"), GEOMETRIES)
@pytest.mark.parametrize("count", [1, 5, 16, 70])
def test_torch_alone_answers_what_the_network_does(image_size, config, count):
    assert_answers(TorchImages(), *make(image_size, config, count))


@needs_compiler
@pytest.mark.parametrize(("image_size", "config"), GEOMETRIES)
@pytest.mark.parametrize("count", [1, 5, 16, 70])
def test_the_compiled_kernels_answer_what_the_network_does(image_size, config, count):
    asked = fastest_images(image_size, config)
    assert isinstance(asked, CompiledImages)
    assert_answers(asked, *make(image_size, config, count))


@needs_compiler
def test_the_compiled_kernels_take_images_of_the_papers_size():
    assert_answers(fastest_images((180, 180), ModelConfig()), *make((180, 180), ModelConfig(), 20))


@needs_compiler
def test_networks_of_one_geometry_share_threads_and_memory_and_keep_their_own_weights():
    asked = fastest_images(*GEOMETRIES[0])
    assert fastest_images(*GEOMETRIES[0]) is asked
    assert fastest_images(*GEOMETRIES[1]) is not asked
    for seed in (0, 1, 0):
        assert_answers(asked, *make(*GEOMETRIES[0], 20, seed))


@needs_compiler
def test_several_threads_may_ask_at_once():
    asked = fastest_images(*GEOMETRIES[0])
    questions = [make(*GEOMETRIES[0], 40, seed) for seed in range(6)]
    with ThreadPoolExecutor(6) as pool:
        found = list(pool.map(lambda question: answers(asked, *question), 5 * questions))
    expected = [answers(asked, *question) for question in questions]
    for index, both in enumerate(found):
        assert all(torch.equal(*pair) for pair in zip(both, expected[index % 6]))


@needs_compiler
def test_of_many_images_no_more_than_one_group_for_each_thread_is_in_memory():
    asked = fastest_images(*GEOMETRIES[0])
    network, images, features = make(*GEOMETRIES[0], 400)
    answers(asked, network, images, features)
    spare = asked._native._spare
    assert spare
    values = [values for rooms in spare.values() for room in rooms for values in room.tensors.values()]
    assert {(each.dim(), each.shape[-1]) for each in values} == {(4, asked._native.kernels.lanes)}
    assert all(len(rooms) <= torch.get_num_threads() for rooms in spare.values())


def test_torch_takes_long_streams_in_parts(monkeypatch):
    network, images, features = make(*GEOMETRIES[0], 150)
    sizes = []
    for part in (network.image_encoder, network.image_decoder):
        part.register_forward_hook(lambda _, inputs, __: sizes.append(len(inputs[0])))
    answers(TorchImages(), network, images, features)
    assert sizes == [64, 64, 22] * 2


@needs_compiler
def test_a_weight_that_is_not_a_number_shows_in_what_is_answered():
    network, images, features = make(*GEOMETRIES[0], 3)
    network.image_encoder[0].bias[0] = network.image_decoder[-1].bias[0] = math.nan
    asked = fastest_images(*GEOMETRIES[0])
    assert all(answer.isnan().any() for answer in answers(asked, network, images, features))


def test_without_a_compiler_torch_answers(monkeypatch, tmp_path):
    monkeypatch.setenv("CC", str(tmp_path / "no-such-compiler"))
    assert isinstance(fastest_images(*GEOMETRIES[0]), TorchImages)


@needs_compiler
def test_another_number_of_threads_is_taken_over():
    before = torch.get_num_threads()
    first = fastest_images(*GEOMETRIES[0])
    try:
        torch.set_num_threads(before + 1)
        assert fastest_images(*GEOMETRIES[0])._native.threads == before + 1
    finally:
        torch.set_num_threads(before)
    assert fastest_images(*GEOMETRIES[0]) is first


@needs_compiler
def test_layers_of_a_few_inputs_are_answered_in_inference_mode_too():
    network, _, _ = make((45, 45), ModelConfig(), 1)
    images = fastest_images((45, 45), ModelConfig())
    inputs = torch.randn(3, network.decoder[-1].in_features)
    with torch.inference_mode():
        for _ in range(20):  # whichever thread takes a piece
            assert torch.allclose(images.linear(network.decoder[-1], inputs), network.decoder[-1](inputs), atol=1e-5)
