"""The loss of Paper, Eq. 30: terms computed by hand, and the reference implementation."""

import math

import pytest
import torch

from embodied_active_learning.config import ModelConfig
from embodied_active_learning.model.cvae import LatentGaussian
from embodied_active_learning.model.loss import (
    PlainLoss,
    kl_divergence,
    negative_log_likelihood,
    plain_loss,
    total_loss,
)
from loss_cases import make_case


def test_negative_log_likelihood_matches_hand_computed_value():
    images = torch.tensor([[[[1.0, 0.0]]], [[[0.5, 0.5]]]])
    means = torch.tensor([[[[0.0, 0.0]]], [[[0.5, 0.1]]]])
    log_std = torch.tensor([math.log(0.5), math.log(2.0)])
    first = 0.5 * 0.5 / 0.25 + math.log(0.5)
    second = 0.5 * 0.08 / 4.0 + math.log(2.0)
    expected = (first + second) / 2 + 0.5 * math.log(2 * math.pi)
    assert negative_log_likelihood(images, means, log_std).item() == pytest.approx(expected, rel=1e-6)


def test_kl_divergence_sums_latents_and_averages_batch():
    latent = LatentGaussian(torch.tensor([[1.0, 2.0], [0.0, 0.0]]), torch.tensor([[0.0, 0.0], [math.log(4.0), 0.0]]))
    expected = ((0.5 + 2.0) + 0.5 * (4.0 - 1.0 - math.log(4.0))) / 2
    assert kl_divergence(latent).item() == pytest.approx(expected, rel=1e-6)


def test_total_loss_weights_terms_by_beta_and_gamma():
    kl = kl_divergence(LatentGaussian(torch.tensor([[2.0]]), torch.zeros(1, 1)))
    loss = total_loss(torch.tensor(1.0), torch.tensor(10.0), kl, beta=0.1, gamma=0.02)
    assert loss.item() == pytest.approx(1.0 + 0.1 * 2.0 + 0.02 * 10.0)


def test_conditional_term_decodes_same_latent_at_other_state():
    network, pair, noise = make_case((45, 45), ModelConfig(), 3)
    terms = plain_loss(network, pair, noise, 0.0, 0.0)
    latent = network.encode(pair.states[:3], pair.images[:3])
    means, log_std = network.decode(latent.mean + latent.std * noise, pair.states[3:])
    images = pair.images[3:].permute(0, 3, 1, 2) / 255.0
    expected = negative_log_likelihood(images, means, log_std).item()
    assert terms.conditional_reconstruction.item() == pytest.approx(expected, rel=1e-5)
    assert terms.total.item() == pytest.approx(terms.reconstruction.item(), rel=1e-6)


def test_plain_loss_replaces_gradients_of_previous_call():
    network, pair, noise = make_case((45, 45), ModelConfig(), 2)
    loss = PlainLoss("plain")
    loss.compute_gradients(network, pair, noise, 1e-3, 0.07)
    first = [parameter.grad.clone() for parameter in network.parameters()]
    terms = loss.compute_gradients(network, pair, noise, 1e-3, 0.07)
    for parameter, gradient in zip(network.parameters(), first):
        torch.testing.assert_close(parameter.grad, gradient)
    expected = sum(gradient.double().sum() for gradient in first)
    assert terms.gradient_sum.item() == pytest.approx(expected.item(), rel=1e-3, abs=1e-3)


def test_plain_loss_accepts_a_list_of_images():
    network, pair, noise = make_case((45, 45), ModelConfig(), 2)
    whole = plain_loss(network, pair, noise, 1e-3, 0.07)
    listed = plain_loss(network, pair._replace(images=list(pair.images)), noise, 1e-3, 0.07)
    assert torch.equal(whole.total, listed.total)
