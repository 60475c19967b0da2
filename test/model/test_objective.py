"""The loss, by hand and against its fast stand-in."""

import copy
import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.nn import functional

from embodied_active_learning.config import ModelConfig
from embodied_active_learning.model.block_images import BlockImages
from embodied_active_learning.model.blocks import BlockLayer
from embodied_active_learning.model.cvae import ConditionalVAE, LatentGaussian
from embodied_active_learning.model.fast import FastLoss, fastest_loss
from embodied_active_learning.model.native.convolutions import NativeImages
from embodied_active_learning.model.native.kernels import Kernels
from embodied_active_learning.model.native.library import load_library
from embodied_active_learning.model.native.loss import NativeLoss
from embodied_active_learning.model.objective import Batch, kl_divergence, negative_log_likelihood, plain_loss, weigh

LIBRARY, REASON = load_library()
needs_compiler = pytest.mark.skipif(LIBRARY is None, reason=REASON)

GEOMETRIES = [
    ((45, 45), ModelConfig()),
    ((52, 37), ModelConfig(hidden_sizes=(40,))),
    ((44, 61), ModelConfig(channels=(4, 6), kernels=(4, 3), strides=(3, 3))),
    ((44, 61), ModelConfig(channels=(4, 6, 5), kernels=(2, 5, 3), strides=(3, 3, 1))),
    ((30, 41), ModelConfig(channels=(4,), kernels=(5,), strides=(2,))),
    ((16, 16), ModelConfig(channels=(4,), kernels=(1,), strides=(4,))),
    ((44, 44), ModelConfig(channels=(4, 6), kernels=(1, 3), strides=(2, 2))),
    ((48, 47), ModelConfig(channels=(7, 11), kernels=(3, 5), strides=(2, 3))),
    ((41, 43), ModelConfig(channels=(9, 4), kernels=(5, 3), strides=(3, 2))),
    ((9, 7), ModelConfig(channels=(2, 3), kernels=(3, 3), strides=(2, 2))),
    ((30, 11), ModelConfig(channels=(3, 2), kernels=(3, 5), strides=(2, 3))),
]


def make(image_size, config, size, dtype=torch.float32):
    torch.manual_seed(0)
    network = ConditionalVAE(image_size, 3, config).to(dtype)
    images = torch.randint(0, 256, (2 * size, *image_size, 3), dtype=torch.uint8)
    pair = Batch((torch.rand(2 * size, 3) * 2 - 1).to(dtype), images)
    return network, pair, torch.randn(size, config.latent_size).to(dtype)


def compiled(network):
    return NativeLoss(NativeImages(network, Kernels(LIBRARY)))


def gradients(loss, network, *arguments):
    terms = loss(network, *arguments)
    terms.hand_over_gradients(network)
    return terms, [parameter.grad.clone() for parameter in network.parameters()]


def relative_errors(found, expected):
    return [((a.double() - b).norm() / b.norm()).item() for a, b in zip(found, expected)]


def test_negative_log_likelihood_of_two_images_computed_by_hand():
    images = torch.tensor([[[[1.0, 0.0]]], [[[0.5, 0.5]]]])
    means = torch.tensor([[[[0.0, 0.0]]], [[[0.5, 0.1]]]])
    log_std = torch.tensor([math.log(0.5), math.log(2.0)])
    first = 0.5 * 0.5 / 0.25 + math.log(0.5)
    second = 0.5 * 0.08 / 4.0 + math.log(2.0)
    expected = (first + second) / 2 + 0.5 * math.log(2 * math.pi)
    assert negative_log_likelihood(images, means, log_std).item() == pytest.approx(expected, rel=1e-6)


def test_kl_divergence_sums_over_latents_and_averages_over_the_batch():
    latent = LatentGaussian(torch.tensor([[1.0, 2.0], [0.0, 0.0]]), torch.tensor([[0.0, 0.0], [math.log(4.0), 0.0]]))
    expected = ((0.5 + 2.0) + 0.5 * (4.0 - 1.0 - math.log(4.0))) / 2
    assert kl_divergence(latent).item() == pytest.approx(expected, rel=1e-6)


def test_the_terms_are_weighed_by_beta_and_gamma():
    latent = LatentGaussian(torch.tensor([[2.0]]), torch.zeros(1, 1))
    loss = weigh(torch.tensor(1.0), torch.tensor(10.0), latent, beta=0.1, gamma=0.02)
    assert loss.total.item() == pytest.approx(1.0 + 0.1 * 2.0 + 0.02 * 10.0)


def test_the_conditional_term_pairs_the_same_latent_with_the_other_batch_by_position():
    network, pair, noise = make((45, 45), ModelConfig(), 3)
    loss = plain_loss(network, pair, noise, 0.0, 0.0)
    latent = network.encode(pair.states[:3], pair.images[:3])
    means, log_std = network.decode(latent.mean + latent.std * noise, pair.states[3:])
    images = pair.images[3:].permute(0, 3, 1, 2) / 255.0
    expected = negative_log_likelihood(images, means, log_std).item()
    assert loss.conditional_reconstruction.item() == pytest.approx(expected, rel=1e-5)
    assert loss.total.item() == pytest.approx(loss.reconstruction.item(), rel=1e-6)


@pytest.mark.parametrize(("image_size", "config"), GEOMETRIES)
def test_the_loss_over_blocks_has_the_plain_gradients_to_double_precision(image_size, config):
    network, pair, noise = make(image_size, config, 18, torch.float64)
    arguments = (pair, noise, 1e-3, 0.07)
    plain, expected = gradients(plain_loss, network, *arguments)
    fast, found = gradients(FastLoss(BlockImages(network)), network, *arguments)
    assert torch.allclose(torch.stack(fast[:4]), torch.stack(plain[:4]), rtol=1e-12)
    assert max(relative_errors(found, expected)) < 1e-12


@settings(deadline=None)
@given(
    kernel=st.integers(1, 5),
    stride=st.integers(1, 4),
    narrow=st.tuples(st.integers(1, 4), st.integers(1, 4)),
    data=st.data(),
)
def test_convolutions_over_parts_are_those_of_torch_both_ways_whatever_the_geometry(kernel, stride, narrow, data):
    rest = data.draw(st.tuples(st.integers(0, stride - 1), st.integers(0, stride - 1)))
    wide = tuple((few - 1) * stride + kernel + more for few, more in zip(narrow, rest))
    torch.manual_seed(0)
    weight = torch.randn(3, 2, kernel, kernel, dtype=torch.float64, requires_grad=True)
    few, many = torch.randn(2, 3, *narrow).double(), torch.randn(2, 2, *wide).double()
    layer = BlockLayer(wide, narrow, kernel, stride)
    kernels = layer.kernels(weight.detach())
    parts = layer.split(many.permute(0, 2, 3, 1), torch.float64)
    there = functional.conv2d(many, weight, weight[:, 0, 0, 0], stride)
    assert torch.allclose(layer.off_grid(layer.contract(parts, kernels, weight[:, 0, 0, 0])), there)
    back = functional.conv_transpose2d(few, weight, weight[0, :, 0, 0], stride, output_padding=rest)
    spread = layer.expand(layer.on_grid(few), kernels, weight[0, :, 0, 0])
    assert torch.allclose(layer.join(spread, wide), back.permute(0, 2, 3, 1))
    (gradient,) = torch.autograd.grad(functional.conv2d(many, weight, None, stride), weight, few)
    assert torch.allclose(layer.weight_gradient(parts, layer.on_grid(few)), gradient)


def test_the_loss_over_blocks_is_the_same_to_the_last_bit_whichever_thread_is_free():
    network, pair, noise = make((45, 45), ModelConfig(), 60)
    fast = FastLoss(BlockImages(network))
    _, expected = gradients(fast, network, pair, noise, 1e-3, 0.07)
    for _ in range(5):
        _, found = gradients(fast, network, pair, noise, 1e-3, 0.07)
        assert all(map(torch.equal, found, expected))


def compare_in_single_precision(loss, network, pair, noise):
    double = copy.deepcopy(network).double()
    widened = Batch(pair.states.double(), pair.images)
    plain, expected = gradients(plain_loss, double, widened, noise.double(), 1e-3, 0.07)
    fast, found = gradients(loss, network, pair, noise, 1e-3, 0.07)
    assert torch.allclose(torch.stack(fast[:4]).double(), torch.stack(plain[:4]), rtol=1e-5, atol=1e-6)
    errors = sorted(relative_errors(found, expected))
    assert errors[-1] < 1e-4
    assert errors[len(errors) // 2] < 3e-6


@needs_compiler
@pytest.mark.parametrize(("image_size", "config"), GEOMETRIES)
def test_the_compiled_loss_has_the_plain_gradients_at_any_geometry_and_batch_size(image_size, config):
    network, pair, noise = make(image_size, config, 11)
    compare_in_single_precision(compiled(network), network, pair, noise)


@needs_compiler
def test_the_compiled_loss_has_the_plain_gradients_where_layers_are_large_enough_for_the_compiled_product():
    network, pair, noise = make((61, 58), ModelConfig(channels=(6, 8), kernels=(3, 3), strides=(2, 2)), 70)
    images = NativeImages(network, Kernels(LIBRARY))
    assert min(70, network.feature_size) >= images.kernels.panel
    compare_in_single_precision(NativeLoss(images), network, pair, noise)


@needs_compiler
@given(
    rows=st.integers(1, 20),
    depth=st.integers(1, 1100),
    excess=st.integers(0, 70),
    turned=st.booleans(),
    margin=st.integers(0, 3),
)
def test_the_compiled_product_is_the_product_of_matrices_of_any_size_and_leaves_the_rest_alone(
    rows, depth, excess, turned, margin
):
    kernels = Kernels(LIBRARY)
    columns = kernels.panel + excess
    random = torch.Generator().manual_seed(rows * depth + columns)
    left = torch.randn(depth, rows, generator=random).t() if turned else torch.randn(rows, depth, generator=random)
    right = torch.randn(depth, columns + margin, generator=random)[:, margin:]
    whole = torch.full((rows, columns + 2 * margin), 7.0)
    out = whole[:, margin : margin + columns]
    kernels.multiply(left, right, out)
    expected = left.double() @ right.double()
    assert torch.allclose(out.double(), expected, rtol=1e-5, atol=1e-5 * math.sqrt(depth))
    assert torch.all(whole[:, :margin] == 7.0)
    assert torch.all(whole[:, margin + columns :] == 7.0)


@needs_compiler
def test_the_compiled_loss_is_as_exact_as_the_plain_one_at_180_pixels():
    network, pair, noise = make((180, 180), ModelConfig(), 9)
    compare_in_single_precision(compiled(network), network, pair, noise)


def test_the_loss_over_blocks_is_as_exact_as_the_plain_one_at_180_pixels():
    network, pair, noise = make((180, 180), ModelConfig(), 4)
    compare_in_single_precision(FastLoss(BlockImages(network)), network, pair, noise)


def test_gradients_lie_in_memory_as_their_parameters_do_which_the_optimiser_takes_for_granted():
    network, pair, noise = make((45, 45), ModelConfig(), 2)
    losses = [plain_loss, FastLoss(BlockImages(network)), fastest_loss(network).loss]
    for loss in losses:
        gradients(loss, network, pair, noise, 1e-3, 0.07)
        assert all(parameter.grad.stride() == parameter.stride() for parameter in network.parameters())


def test_gradients_scale_with_what_is_asked_of_the_loss_over_blocks():
    network, pair, noise = make((45, 45), ModelConfig(), 2)
    fast = FastLoss(BlockImages(network))
    _, once = gradients(fast, network, pair, noise, 1e-3, 0.07)
    network.zero_grad()
    (3.0 * fast(network, pair, noise, 1e-3, 0.07).total).backward()
    for parameter, gradient in zip(network.parameters(), once):
        assert torch.allclose(parameter.grad, 3.0 * gradient, rtol=1e-4, atol=1e-7)


@needs_compiler
def test_two_compiled_losses_in_flight_do_not_share_memory():
    network, pair, noise = make((45, 45), ModelConfig(), 3)
    fast = compiled(network)
    _, expected = gradients(fast, network, pair, noise, 1e-3, 0.07)
    waiting = fast(network, pair, noise, 1e-3, 0.07)
    fast(network, Batch(pair.states, 255 - pair.images), noise, 1e-3, 0.07)
    waiting.hand_over_gradients(network)
    assert max(relative_errors([part.grad for part in network.parameters()], expected)) < 1e-6


@needs_compiler
def test_a_weight_that_is_not_a_number_shows_in_the_compiled_loss():
    network, pair, noise = make((45, 45), ModelConfig(), 3)
    with torch.no_grad():
        network.image_encoder[0].weight[0, 0, 0, 0] = math.nan
    assert math.isnan(fastest_loss(network).loss(network, pair, noise, 1e-3, 0.07).total.item())


def test_without_a_compiler_torch_does_the_work_and_the_reason_is_told(monkeypatch, tmp_path):
    monkeypatch.setenv("CC", str(tmp_path / "no-such-compiler"))
    network, pair, noise = make((45, 45), ModelConfig(), 2)
    loss, reason, *_ = fastest_loss(network)
    assert "no C compiler" in reason
    assert torch.isfinite(loss(network, pair, noise, 1e-3, 0.07).total)


@needs_compiler
def test_images_are_read_where_they_are_stored_and_nothing_is_read_between_their_rows():
    network, pair, noise = make((45, 45), ModelConfig(), 11)
    _, expected = gradients(compiled(network), network, pair, noise, 1e-3, 0.07)
    apart = [image.clone() for image in pair.images]
    _, found = gradients(compiled(network), network, pair._replace(images=apart), noise, 1e-3, 0.07)
    assert all(torch.equal(one, other) for one, other in zip(found, expected))
    with pytest.raises(ValueError, match="one piece"):
        compiled(network)(network, pair._replace(images=pair.images.transpose(1, 2)), noise, 1e-3, 0.07)


@needs_compiler
def test_the_compiled_loss_tells_the_sum_of_its_gradients_so_that_none_that_is_no_number_goes_unseen():
    network, pair, noise = make((61, 58), ModelConfig(channels=(6, 8), kernels=(3, 3), strides=(2, 2)), 70)
    terms, found = gradients(compiled(network), network, pair, noise, 1e-3, 0.07)
    expected = sum(gradient.double().sum() for gradient in found)
    assert terms.gradient_sum.item() == pytest.approx(expected.item(), rel=1e-3, abs=1e-3)
    for layer in (network.encoder[2], network.decoder[0], network.image_encoder[0], network.image_decoder[-1]):
        poisoned = copy.deepcopy(network)
        names = {id(part): name for name, part in network.named_parameters()}
        with torch.no_grad():
            dict(poisoned.named_parameters())[names[id(layer.weight)]].fill_(math.inf)
        assert not compiled(poisoned)(poisoned, pair, noise, 1e-3, 0.07).gradient_sum.isfinite()
