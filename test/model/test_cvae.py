"""The network: sizes of Paper, Table 2, at any image size; shortcuts equal the full computation."""

import pytest
import torch
from torch import nn

from embodied_active_learning.config import ModelConfig
from embodied_active_learning.errors import ConfigError
from embodied_active_learning.model.cvae import ConditionalVAE, convolution_sizes, initialise

SMALL = (45, 45)


def build(image_size=SMALL, state_size=3, **model):
    torch.manual_seed(0)
    return ConditionalVAE(image_size, state_size, ModelConfig(**model))


def count(module):
    return sum(parameter.numel() for parameter in module.parameters())


def random_images(number, image_size=SMALL):
    return torch.randint(0, 256, (number, *image_size, 3), dtype=torch.uint8)


def test_network_has_the_papers_number_of_parameters():
    network = build((180, 180))
    parts = (network.image_encoder, network.encoder, network.decoder, network.image_decoder)
    assert [count(part) for part in parts] == [6210, 2148640, 2148177, 6193]
    assert count(network) == 4309220


def test_paper_geometry_reduces_180_to_14_pixels():
    assert convolution_sizes((180, 180), ModelConfig()) == [(180, 180), (89, 89), (44, 44), (14, 14)]


def test_network_for_small_images_has_fewer_parameters():
    assert count(build()) == 373220


@pytest.mark.parametrize("image_size", [(45, 45), (48, 64), (61, 44), (50, 47)])
@pytest.mark.parametrize("state_size", [1, 3, 6])
def test_decoded_images_have_the_input_size(image_size, state_size):
    network = build(image_size, state_size)
    states = torch.zeros(2, state_size)
    latent = network.encode(states, random_images(2, image_size))
    images, log_std = network.decode(latent.mean, states)
    assert latent.mean.shape == latent.log_variance.shape == latent.std.shape == (2, 16)
    assert images.shape == (2, 3, *image_size)
    assert log_std.shape == (2,)


def test_image_too_small_for_convolutions_is_refused():
    with pytest.raises(ConfigError, match=r"20 x 200.*convolution 3.*kernel is 5"):
        build((20, 200))


def test_both_heads_are_clamped_to_their_limits():
    network = build()
    with torch.no_grad():
        network.encoder[-1].bias[16:] = 50.0
        network.decoder[-1].bias[0] = -50.0
    latent = network.encode(torch.zeros(1, 3), random_images(1))
    _, log_std = network.decode(latent.mean, torch.zeros(1, 3))
    assert torch.all(latent.log_variance == 2.0)
    assert log_std.item() == -10.0


def test_latent_head_is_a_log_variance():
    network = build()
    with torch.no_grad():
        network.encoder[-1].weight.zero_()
        network.encoder[-1].bias[16:] = -2.0
    latent = network.encode(torch.zeros(1, 3), random_images(1))
    assert torch.allclose(latent.std, torch.exp(torch.tensor(-1.0)).expand(1, 16))


@pytest.mark.parametrize("hidden_sizes", [(512, 256), (32,)])
def test_log_std_equals_first_decoder_output(hidden_sizes):
    network = build(hidden_sizes=hidden_sizes)
    latent, states = torch.randn(16), torch.rand(50, 3)
    whole, _ = network.decode_features(latent.expand(50, 16), states)
    assert torch.allclose(network.log_std(latent, states), whole, atol=1e-6)
    assert torch.allclose(network.log_std(latent.expand(50, 16), states), whole, atol=1e-6)


def test_shared_image_equals_repeated_image():
    network = build()
    image, states = random_images(1), torch.rand(7, 3)
    shared = network.encode_features(states, network.image_features(image))
    repeated = network.encode(states, image.expand(7, -1, -1, -1))
    assert torch.allclose(shared.mean, repeated.mean, atol=1e-6)
    assert torch.allclose(shared.log_variance, repeated.log_variance, atol=1e-6)


def test_initialisation_has_pytorchs_bounds():
    network = build()
    bounds = [parameter.abs().max().item() for parameter in network.parameters()]
    initialise(network, torch.Generator().manual_seed(1))
    for parameter, bound in zip(network.parameters(), bounds):
        if parameter.numel() > 500:
            assert parameter.abs().max().item() == pytest.approx(bound, rel=0.02)


def test_initialisation_uses_only_its_generator():
    before = torch.random.get_rng_state()
    layers = [nn.Linear(5, 4, device="meta").to_empty(device="cpu") for _ in range(2)]
    for layer in layers:
        initialise(layer, torch.Generator().manual_seed(3))
    assert torch.equal(layers[0].weight, layers[1].weight)
    assert torch.equal(before, torch.random.get_rng_state())
