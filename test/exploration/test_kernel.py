"""Coverage kernel: the authors' variance, hand-computed values, mass inside the workspace."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from embodied_active_learning.exploration.kernel import CoverageKernel, kernel_variance

STATE = arrays(np.float64, (3,), elements=st.floats(-1, 1))


@pytest.mark.parametrize(("samples", "variance"), [(1000, 0.057588), (2000, 0.045708)])
def test_default_variance_equals_authors_rule(samples, variance):
    assert kernel_variance(samples, 3) == pytest.approx(variance, abs=5e-7)


def test_kernel_by_hand():
    psi = CoverageKernel(variance=0.05)(np.array([[0.3, 0.0, -0.1]]), np.array([[0.1, 0.0, 0.0], [0.3, 0.0, -0.1]]))
    np.testing.assert_allclose(psi, [[np.exp(-0.5 * (0.04 + 0.01) / 0.05)], [1.0]], rtol=1e-5)


@given(arrays(np.float64, (20, 3), elements=st.floats(-1.15, 1.15)), STATE)
def test_single_precision_kernel_close_to_exact(samples, state):
    exact = np.exp(-0.5 * np.sum((samples - state) ** 2, axis=1) / 0.0576)
    np.testing.assert_allclose(CoverageKernel(0.0576)(samples, state[np.newaxis])[0], exact, rtol=5e-5, atol=1e-30)


@given(STATE, st.sampled_from([1.0, 1.15]))
def test_mass_equals_integral_of_gaussian_over_box(state, box):
    edges = np.linspace(-box, box, 4001)
    middle, width = (edges[1:] + edges[:-1]) / 2, edges[1] - edges[0]
    gaussian = np.exp(-0.5 * (middle - state[:, np.newaxis]) ** 2 / 0.0576) / np.sqrt(2 * np.pi * 0.0576)
    mass = np.prod(np.sum(gaussian, axis=1) * width)
    assert CoverageKernel(0.0576, box, normalise=True).log_mass(state) == pytest.approx(np.log(mass), abs=1e-5)


def test_mass_in_corner_is_one_eighth():
    assert np.exp(CoverageKernel(0.0576, normalise=True).log_mass(np.ones(3))) == pytest.approx(1 / 8, rel=1e-6)


@given(arrays(np.float64, (3,), elements=st.floats(-0.999, 0.999)))
def test_mass_gradient_equals_finite_differences(state):
    kernel, step = CoverageKernel(0.0576, normalise=True), 1e-5
    shifts = step * np.eye(3)
    numeric = (kernel.log_mass(state + shifts) - kernel.log_mass(state - shifts)) / (2 * step)
    np.testing.assert_allclose(kernel.log_mass_gradient(state), numeric, atol=1e-6)


def test_mass_outside_equals_mass_at_border():
    kernel = CoverageKernel(0.0576, normalise=True)
    assert kernel.log_mass(np.array([3.0, 0.0, 0.0])) == kernel.log_mass(np.array([1.0, 0.0, 0.0]))
    assert kernel.log_mass_gradient(np.array([3.0, 0.0, 0.0]))[0] == 0.0
