"""The terms of the generalisation bound."""

import numpy as np
import pytest
import torch

from embodied_active_learning.config import Config
from embodied_active_learning.evaluation.ergodicity import Views
from embodied_active_learning.evaluation.pac_bayes import bound_terms, spectral_norm
from embodied_active_learning.model.cvae import ConditionalVAE
from tiny import TINY


def test_spectral_norm_is_that_of_a_matrix():
    matrix = torch.tensor([[3.0, 0.0, 1.0], [0.0, -2.0, 0.5]])
    found = spectral_norm(lambda x: x @ matrix.T, torch.zeros(1, 3), torch.Generator().manual_seed(0))
    assert found == pytest.approx(float(torch.linalg.matrix_norm(matrix, 2)), rel=1e-3)


def test_constant_function_has_norm_zero():
    assert spectral_norm(lambda x: 0.0 * x, torch.zeros(1, 3), torch.Generator().manual_seed(0)) == 0.0


def test_terms_of_a_decoder_that_ignores_its_input():
    """All Lipschitz terms vanish; the risk is the distance to the constant image, and the bound holds."""
    torch.manual_seed(0)  # a network of this size may have no active unit
    config = Config.from_dict(TINY)
    workspace, random = config.workspace.box(), np.random.default_rng(0)
    network = ConditionalVAE((24, 24), workspace.size, config.model).eval().requires_grad_(False)
    for layer in network.image_decoder:
        if hasattr(layer, "weight"):
            layer.weight.zero_()
            layer.bias.zero_()
    states = random.uniform(workspace.lower, workspace.upper, (2, 20, 3))
    images = random.integers(0, 256, (2, 20, 24, 24, 3), np.uint8)
    first, second = (Views(*part) for part in zip(states, images))
    terms = bound_terms(network, workspace, first, second, 0, probes=1)
    expected = np.sqrt(((second.images / 255.0) ** 2).sum(axis=(1, 2, 3))).mean()
    assert terms.risk == pytest.approx(expected, rel=1e-5)
    assert (terms.decoder_lipschitz, terms.continuity, terms.condition) == (0.0, 0.0, 0.0)
    assert terms.encoder_lipschitz > 0.0
    assert terms.bound >= terms.risk
