"""The loss on the compiled kernels: value and gradient of the reference, whatever the geometry."""

import copy
import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from embodied_active_learning.config import ModelConfig
from embodied_active_learning.model import build
from embodied_active_learning.model.loss import Batch, PlainLoss
from embodied_active_learning.model.native.library import LoadedKernels, load_kernels
from embodied_active_learning.model.native.loss import NativeLoss
from loss_cases import make_case

KERNELS, DESCRIPTION = load_kernels()
needs_kernels = pytest.mark.skipif(KERNELS is None, reason=DESCRIPTION)
CPU = torch.device("cpu")

GEOMETRIES = [
    ((45, 45), ModelConfig()),
    ((52, 37), ModelConfig(hidden_sizes=(40,))),
    ((44, 61), ModelConfig(channels=(4, 6), kernels=(4, 3), strides=(3, 3))),
    ((44, 61), ModelConfig(channels=(4, 6, 5), kernels=(3, 5, 3), strides=(3, 3, 1))),
    ((30, 41), ModelConfig(channels=(4,), kernels=(5,), strides=(2,))),
    ((48, 47), ModelConfig(channels=(7, 11), kernels=(3, 5), strides=(2, 3))),
    ((41, 43), ModelConfig(channels=(9, 4), kernels=(5, 3), strides=(3, 2))),
    ((9, 7), ModelConfig(channels=(2, 3), kernels=(3, 3), strides=(2, 2))),
    ((30, 11), ModelConfig(channels=(3, 2), kernels=(3, 5), strides=(2, 3))),
]
LARGE_LAYERS = (61, 58), ModelConfig(channels=(6, 8), kernels=(3, 3), strides=(2, 2))


def native(network):
    return NativeLoss(network, KERNELS, "kernels")


def gradients(loss, network, pair, noise):
    terms = loss.compute_gradients(network, pair, noise, 1e-3, 0.07)
    return terms, [parameter.grad.clone() for parameter in network.parameters()]


def relative_errors(found, expected):
    return [((a.double() - b).norm() / b.norm()).item() for a, b in zip(found, expected)]


def assert_matches_double_precision(loss, network, pair, noise):
    double = copy.deepcopy(network).double()
    widened = Batch(pair.states.double(), pair.images)
    plain, expected = gradients(PlainLoss("plain"), double, widened, noise.double())
    terms, found = gradients(loss, network, pair, noise)
    assert torch.allclose(torch.stack(terms[:4]).double(), torch.stack(plain[:4]), rtol=1e-5, atol=1e-6)
    assert torch.allclose(terms.latent_means.double(), plain.latent_means, atol=1e-5)
    errors = sorted(relative_errors(found, expected))
    assert errors[-1] < 1e-4
    assert errors[len(errors) // 2] < 3e-6


@needs_kernels
@pytest.mark.parametrize(("image_size", "config"), GEOMETRIES)
def test_native_gradients_match_reference(image_size, config):
    network, pair, noise = make_case(image_size, config, 11)
    assert_matches_double_precision(native(network), network, pair, noise)


@needs_kernels
def test_native_gradients_match_reference_in_large_layers():
    """Layers that are large enough for the compiled matrix product."""
    network, pair, noise = make_case(*LARGE_LAYERS, 70)
    loss = native(network)
    assert min(70, network.feature_size) >= loss.convolutions.kernels.panel_columns
    assert_matches_double_precision(loss, network, pair, noise)


@needs_kernels
def test_native_gradients_match_reference_at_180_pixels():
    network, pair, noise = make_case((180, 180), ModelConfig(), 9)
    assert_matches_double_precision(native(network), network, pair, noise)


@needs_kernels
@settings(max_examples=20)
@given(
    stride=st.integers(1, 4),
    overlap=st.integers(0, 3),
    inner=st.tuples(st.integers(1, 6), st.integers(1, 9)),
    data=st.data(),
)
def test_native_convolutions_match_torch_for_any_geometry(stride, overlap, inner, data):
    kernel = stride + overlap
    rest = data.draw(st.tuples(st.integers(0, stride - 1), st.integers(0, stride - 1)))
    image_size = tuple((few - 1) * stride + kernel + more for few, more in zip(inner, rest))
    config = ModelConfig(channels=(6,), kernels=(kernel,), strides=(stride,), hidden_sizes=(8,))
    network, pair, noise = make_case(image_size, config, 3)
    terms, found = gradients(native(network), network, pair, noise)
    plain, expected = gradients(PlainLoss("plain"), network, pair, noise)
    assert torch.allclose(terms.total, plain.total, rtol=1e-5, atol=1e-6)
    for one, other in zip(found, expected):
        torch.testing.assert_close(one, other, rtol=1e-3, atol=1e-5)


@needs_kernels
@given(
    rows=st.integers(1, 20),
    depth=st.integers(1, 1100),
    excess=st.integers(0, 70),
    transposed=st.booleans(),
    margin=st.integers(0, 3),
)
def test_matmul_matches_torch_and_writes_only_its_output(rows, depth, excess, transposed, margin):
    columns = KERNELS.panel_columns + excess
    random = torch.Generator().manual_seed(rows * depth + columns)
    left = torch.randn(depth, rows, generator=random).t() if transposed else torch.randn(rows, depth, generator=random)
    right = torch.randn(depth, columns + margin, generator=random)[:, margin:]
    whole = torch.full((rows, columns + 2 * margin), 7.0)
    out = whole[:, margin : margin + columns]
    KERNELS.matmul(left, right, out)
    expected = left.double() @ right.double()
    assert torch.allclose(out.double(), expected, rtol=1e-5, atol=1e-5 * math.sqrt(depth))
    assert torch.all(whole[:, :margin] == 7.0)
    assert torch.all(whole[:, margin + columns :] == 7.0)


@needs_kernels
def test_native_gradients_are_identical_in_every_call():
    network, pair, noise = make_case((45, 45), ModelConfig(), 60)
    loss = native(network)
    _, expected = gradients(loss, network, pair, noise)
    for _ in range(5):
        _, found = gradients(loss, network, pair, noise)
        assert all(map(torch.equal, found, expected))


@pytest.mark.parametrize("make_loss", [lambda _: PlainLoss("plain"), lambda network: build.choose_loss(network, CPU)])
def test_gradients_have_the_strides_of_their_parameters(make_loss):
    """Fused Adam relies on it."""
    network, pair, noise = make_case((45, 45), ModelConfig(), 2)
    gradients(make_loss(network), network, pair, noise)
    assert all(parameter.grad.stride() == parameter.stride() for parameter in network.parameters())


@needs_kernels
def test_gradients_of_an_earlier_call_stay_unchanged():
    network, pair, noise = make_case((45, 45), ModelConfig(), 3)
    loss = native(network)
    loss.compute_gradients(network, pair, noise, 1e-3, 0.07)
    held = [parameter.grad for parameter in network.parameters()]
    expected = [gradient.clone() for gradient in held]
    loss.compute_gradients(network, Batch(pair.states, 255 - pair.images), noise, 1e-3, 0.07)
    assert all(map(torch.equal, held, expected))


@needs_kernels
def test_nan_weight_gives_nan_loss():
    network, pair, noise = make_case((45, 45), ModelConfig(), 3)
    with torch.no_grad():
        network.image_encoder[0].weight[0, 0, 0, 0] = math.nan
    assert math.isnan(native(network).compute_gradients(network, pair, noise, 1e-3, 0.07).total.item())


def test_plain_loss_is_used_without_kernels(monkeypatch):
    monkeypatch.setattr(build, "load_kernels", lambda: LoadedKernels(None, "not compiled"))
    network, pair, noise = make_case((45, 45), ModelConfig(), 2)
    loss = build.choose_loss(network, CPU)
    assert isinstance(loss, PlainLoss)
    assert loss.description == "not compiled"
    assert torch.isfinite(loss.compute_gradients(network, pair, noise, 1e-3, 0.07).total)


@needs_kernels
def test_images_are_read_where_they_are_stored():
    network, pair, noise = make_case((45, 45), ModelConfig(), 11)
    _, expected = gradients(native(network), network, pair, noise)
    apart = [image.clone() for image in pair.images]
    _, found = gradients(native(network), network, pair._replace(images=apart), noise)
    assert all(torch.equal(one, other) for one, other in zip(found, expected))


@needs_kernels
def test_images_that_are_not_contiguous_are_refused():
    network, pair, noise = make_case((45, 45), ModelConfig(), 11)
    with pytest.raises(ValueError, match="contiguous"):
        gradients(native(network), network, pair._replace(images=pair.images.transpose(1, 2)), noise)


@needs_kernels
def test_gradient_sum_covers_every_gradient():
    network, pair, noise = make_case(*LARGE_LAYERS, 70)
    terms, found = gradients(native(network), network, pair, noise)
    expected = sum(gradient.double().sum() for gradient in found)
    assert terms.gradient_sum.item() == pytest.approx(expected.item(), rel=1e-3, abs=1e-3)
    for layer in (network.encoder[2], network.decoder[0], network.image_encoder[0], network.image_decoder[-1]):
        poisoned = copy.deepcopy(network)
        names = {id(part): name for name, part in network.named_parameters()}
        with torch.no_grad():
            dict(poisoned.named_parameters())[names[id(layer.weight)]].fill_(math.inf)
        poisoned_terms = native(poisoned).compute_gradients(poisoned, pair, noise, 1e-3, 0.07)
        assert not poisoned_terms.gradient_sum.isfinite()
