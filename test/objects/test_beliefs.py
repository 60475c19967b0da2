"""Belief grids and evidence weights."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from embodied_active_learning.config import IdentificationConfig
from embodied_active_learning.errors import ConfigError
from embodied_active_learning.objects.beliefs import BeliefGrid, EvidenceWeights, shared_scale
from embodied_active_learning.workspace import Workspace

WORKSPACE = Workspace()
SETTINGS = IdentificationConfig(
    cells=(20, 16, 12),
    near_variance=0.156,
    far_pull=0.02,
    kernel_std=0.042,
    kernel_yaw_std=0.56,
    margin=0.0225,
    independence_distance=0.01,
    independence_turn=0.2,
)
MEASUREMENTS = st.lists(
    st.tuples(
        st.floats(0.2, 0.8),
        st.floats(-0.3, 0.3),
        st.floats(-math.pi, math.pi),
        st.floats(0.0, 1.0),
        st.floats(0.1, 1.0),
    ),
    min_size=1,
    max_size=6,
)


def make_grid(workspace=WORKSPACE, **values):
    return BeliefGrid(workspace, replace(SETTINGS, **values))


def measure(grid, *measurements):
    """Update with (pose, value) or (pose, value, weight)."""
    for pose, value, *weight in measurements:
        grid.update(np.array([pose]), np.array([value]), np.array(weight or [1.0]))
    return grid


def cell_of(grid, x, y, yaw):
    """Return the indices of the nearest cell."""
    return tuple(int(np.abs(axis - value).argmin()) for axis, value in zip((grid.x, grid.y, grid.yaw), (x, y, yaw)))


def centre_of(grid, index):
    return np.array([grid.x[index[0]], grid.y[index[1]], grid.yaw[index[2]]])


def test_grid_without_cell_inside_the_workspace_is_refused():
    with pytest.raises(ConfigError, match=r"no cell of the belief grid.*use more cells or a smaller margin"):
        make_grid(cells=(4, 4, 4), margin=0.5)


def textbook(grid, prior_mean, prior_variance, pose, value, settings_=SETTINGS, weight=1.0):
    """Multiply the Gaussian belief of each cell with that of a measurement at the centre of a cell.

    r(s) = far + K(s) (near - far), near = near_variance, far = near_variance / far_pull.
    """
    mean, variance = np.empty(prior_mean.shape), np.empty(prior_mean.shape)
    near, far = settings_.near_variance, settings_.near_variance / settings_.far_pull
    for index in np.ndindex(mean.shape):
        dx, dy, dyaw = centre_of(grid, index) - pose
        dyaw = math.atan2(math.sin(dyaw), math.cos(dyaw))
        footprint = math.exp(
            -0.5 * ((dx**2 + dy**2) / settings_.kernel_std**2 + (dyaw / settings_.kernel_yaw_std) ** 2)
        )
        r = (far + footprint * (near - far)) / weight
        m, v = prior_mean[index], prior_variance[index]
        mean[index] = (m * r + value * v) / (v + r)
        variance[index] = v * r / (v + r)
    return mean, variance


def test_belief_starts_at_prior():
    grid = make_grid()
    assert grid.mean.shape == grid.std.shape == (20, 16, 12)
    np.testing.assert_allclose(grid.mean, 0.5)
    np.testing.assert_allclose(grid.std, math.sqrt(2.0))


def test_grid_covers_margin_and_full_circle():
    grid = make_grid(margin=0.02)
    np.testing.assert_allclose(grid.x[[0, -1]], (0.305, 0.645))
    np.testing.assert_allclose(grid.y[[0, -1]], (-0.17, 0.17))
    width = 2.0 * math.pi / 12
    np.testing.assert_allclose(grid.yaw, -math.pi + width * (np.arange(12) + 0.5))


@pytest.mark.parametrize(("index", "value"), [((4, 9, 2), 0.9), ((0, 15, 11), 0.1), ((19, 0, 0), 1.0)])
def test_update_follows_bayes_rule_in_every_cell(index, value):
    grid = make_grid()
    pose = centre_of(grid, index)
    mean, variance = textbook(grid, grid.mean, grid.std**2, pose, value)
    measure(grid, (pose, value))
    np.testing.assert_allclose(grid.mean, mean, rtol=1e-9)
    np.testing.assert_allclose(grid.std, np.sqrt(variance), rtol=1e-9)


def test_near_variance_applies_anywhere_in_measured_cell():
    grid = make_grid()
    index = (7, 5, 3)
    off = np.array([0.4 * (grid.x[1] - grid.x[0]), -0.4 * (grid.y[1] - grid.y[0]), 0.2])
    measure(grid, (centre_of(grid, index) + off, 1.0))
    expected = (0.5 / 2.0 + 1.0 / SETTINGS.near_variance) / (1.0 / 2.0 + 1.0 / SETTINGS.near_variance)
    assert grid.mean[index] == pytest.approx(expected, rel=1e-9)
    assert np.unravel_index(grid.mean.argmax(), grid.mean.shape) == index


@settings(max_examples=25)
@given(st.integers(0, 50), st.integers(0, 50), st.integers(0, 2**31 - 1))
def test_update_adds_information_of_each_measurement(count, first, seed):
    """In two updates of fewer and more measurements than a batch, with poses on and outside the grid."""
    random = np.random.default_rng(seed)
    poses = random.uniform((0.2, -0.3, -math.pi), (0.75, 0.3, math.pi), (count, 3))
    values, weights = random.uniform(0, 1, (2, count))
    grid = make_grid()
    information = np.full(grid.mean.shape, 0.5)
    weighted = 0.5 * information
    for pose, value, weight in zip(poses, values, weights):
        added = weight * plain_information(grid, pose)
        information += added
        weighted += added * value
    for part in (slice(first), slice(first, None)):
        grid.update(poses[part], values[part], weights[part])
    np.testing.assert_allclose(grid.mean, weighted / information, rtol=1e-12)
    np.testing.assert_allclose(grid.std, 1.0 / np.sqrt(information), rtol=1e-12)


def plain_information(grid, pose):
    """Return 1 / r (see BeliefGrid.update) for one pose and the full grid."""
    inside = abs(pose[0] - 0.475) <= 0.1725 and abs(pose[1]) <= 0.1725
    footprint = np.ones(grid.mean.shape)
    scales = ((grid.x, SETTINGS.kernel_std), (grid.y, SETTINGS.kernel_std), (grid.yaw, SETTINGS.kernel_yaw_std))
    for axis, (middles, std) in enumerate(scales):
        away = middles - pose[axis]
        if axis == 2:
            away = np.arctan2(np.sin(away), np.cos(away))
        energy = 0.5 * (away / std) ** 2
        along = np.exp(energy.min() * inside - energy)
        footprint = footprint * np.expand_dims(along, [other for other in range(3) if other != axis])
    far = SETTINGS.near_variance / SETTINGS.far_pull
    return 1.0 / (far + footprint * (SETTINGS.near_variance - far))


@settings(max_examples=25)
@given(MEASUREMENTS)
def test_mean_stays_in_range_and_std_decreases(measurements):
    grid = make_grid()
    for item in measurements:
        before = grid.std
        measure(grid, (item[:3], item[3], item[4]))
        assert np.all(grid.std < before)
        assert np.all((grid.mean >= 0.0) & (grid.mean <= 1.0))


def test_belief_wraps_around_yaw():
    above, below, opposite = (
        measure(make_grid(), ((0.45, 0.0, yaw), 1.0)) for yaw in (math.pi - 0.01, -math.pi + 0.01, 0.0)
    )
    np.testing.assert_allclose(above.mean, below.mean, atol=0.03)
    assert np.abs(above.mean - opposite.mean).max() > 0.3
    mean = above.mean[cell_of(above, 0.45, 0.0, 0.0)[:2]]
    assert mean[0] == pytest.approx(mean[-1], abs=0.03)
    assert mean[0] > mean[1] > mean[2]
    assert mean[-1] > mean[-2] > mean[-3]


def test_belief_ignores_full_turns_of_yaw():
    once, thrice = (measure(make_grid(), ((0.45, 0.0, yaw), 1.0)) for yaw in (0.7, 0.7 + 4 * math.pi))
    np.testing.assert_allclose(once.mean, thrice.mean, rtol=1e-9)


@pytest.mark.parametrize("far_pull", [0.001, 0.02, 0.5])
def test_far_pull_moves_unseen_cells(far_pull):
    grid = measure(make_grid(far_pull=far_pull), ((0.33, -0.14, 0.0), 1.0))
    information = far_pull / SETTINGS.near_variance
    unseen = grid.mean[cell_of(grid, 0.62, 0.14, 3.0)]
    assert unseen == pytest.approx((0.25 + information) / (0.5 + information), rel=1e-6)


def test_far_pull_of_one_updates_all_cells_equally():
    grid = measure(make_grid(far_pull=1.0), ((0.33, -0.14, 0.0), 1.0))
    np.testing.assert_allclose(grid.mean, grid.mean[0, 0, 0])


def test_maps_share_a_scale_with_a_smallest_range():
    flat, peaked = make_grid(), measure(make_grid(), ((0.45, 0.0, 1.0), 1.0))
    assert shared_scale([flat.above_median()]) == 0.05
    assert np.median(peaked.above_median()) == pytest.approx(0.0, abs=1e-12)
    assert shared_scale([flat.above_median(), peaked.above_median()]) == peaked.above_median().max() > 0.05


def test_over_yaw_returns_best_yaw_and_its_std():
    grid = measure(make_grid(), ((0.45, 0.0, 1.0), 1.0), ((0.45, 0.0, -1.0), 0.0), ((0.55, 0.05, 2.0), 0.7))
    mean, std = grid.over_yaw()
    for row, column in np.ndindex(20, 16):
        best = grid.mean[row, column].argmax()
        assert mean[row, column] == grid.mean[row, column, best]
        assert std[row, column] == grid.std[row, column, best]


PLACES = ((0.38, -0.08, -1.2), (0.55, 0.07, 2.9), (0.45, 0.10, 0.3))


def peaked(**values):
    return measure(make_grid(cells=(40, 40, 18), **values), *zip(PLACES, (0.8, 1.0, 0.9)))


def test_peaks_at_measured_poses_highest_first():
    grid = peaked()
    found = grid.peaks(0.06, 12)
    for (pose, mean, std), expected in zip(found, (PLACES[1], PLACES[2], PLACES[0])):
        assert np.abs(pose[:2] - expected[:2]).max() <= 0.5 * (grid.x[1] - grid.x[0]) + 1e-9
        assert abs(pose[2] - expected[2]) <= math.pi / 18 + 1e-9
        index = cell_of(grid, *pose)
        assert mean == grid.mean[index] == grid.mean[index[:2]].max()
        assert std == pytest.approx(grid.std[index])
    means = [mean for _, mean, _ in found]
    assert means == sorted(means, reverse=True)


@pytest.mark.parametrize("distance", [0.03, 0.06, 0.15])
def test_peaks_keep_minimum_distance(distance):
    poses = np.array([pose for pose, _, _ in peaked().peaks(distance, 1000)])
    apart = np.linalg.norm(poses[:, None, :2] - poses[:, :2], axis=2) + 10.0 * np.eye(len(poses))
    assert len(poses) >= 2
    assert apart.min() >= distance


def test_higher_of_two_close_peaks_is_kept():
    grid = measure(make_grid(cells=(40, 40, 18)), ((0.45, 0.0, 0.0), 0.9), ((0.53, 0.0, 0.0), 1.0))
    places = [pose[0] for pose, _, _ in grid.peaks(0.05, 2)]
    assert places == pytest.approx([0.53, 0.45], abs=0.006)
    found = grid.peaks(0.12, 100)
    assert found[0][0][0] == pytest.approx(0.53, abs=0.006)
    assert all(abs(pose[0] - 0.45) > 0.01 for pose, _, _ in found)


@pytest.mark.parametrize("most", [1, 2, 5])
def test_peak_count_is_limited(most):
    assert len(peaked().peaks(0.06, most)) == min(most, len(PLACES))
    assert len(make_grid().peaks(0.06, most)) == most


def test_peaks_exclude_margin():
    grid = measure(make_grid(cells=(40, 40, 18), margin=0.05), ((0.66, 0.0, 0.0), 1.0), ((0.45, 0.1, 0.0), 0.8))
    found = grid.peaks(0.06, 100)
    assert all(WORKSPACE.contains([*pose[:2], 0.0]) for pose, _, _ in found)
    assert found[0][0][:2] == pytest.approx((0.45, 0.1), abs=0.006)


def test_peaks_are_found_where_the_workspace_lacks_yaw_0():
    workspace = Workspace((0.325, -0.15, 0.5), (0.625, 0.15, 2.5))
    grid = measure(make_grid(cells=(40, 40, 18), workspace=workspace), ((0.45, 0.1, 1.0), 0.8))
    assert grid.peaks(0.06, 1)[0].pose[:2] == pytest.approx((0.45, 0.1), abs=0.006)


def test_peak_at_workspace_border_is_found():
    """The belief is higher beyond the border."""
    grid = measure(make_grid(cells=(40, 40, 18), margin=0.05), ((0.645, 0.05, 0.0), 1.0), ((0.45, 0.05, 0.0), 0.0))
    pose, _, _ = grid.peaks(0.06, 1)[0]
    assert pose[:2] == pytest.approx((0.62, 0.05), abs=0.011)


def test_peak_yaw_may_exceed_camera_limits():
    pose, _, _ = measure(make_grid(cells=(40, 40, 18)), ((0.45, 0.0, 3.0), 1.0)).peaks(0.06, 1)[0]
    assert pose[2] == pytest.approx(3.0, abs=math.pi / 18)


def test_yaw_peaks_are_circular_maxima_highest_first():
    grid = measure(
        make_grid(cells=(40, 40, 18)), ((0.45, 0.0, 3.1), 0.9), ((0.45, 0.0, 0.3), 1.0), ((0.45, 0.0, -1.5), 0.8)
    )
    width = 2.0 * math.pi / 18
    found = grid.yaw_peaks(np.array([0.452, 0.003, 1.0]), 3)
    assert found == pytest.approx([0.3, 3.1, -1.5], abs=0.5 * width)
    assert grid.yaw_peaks(np.array([0.452, 0.003, 1.0]), 2) == found[:2]


def test_yaw_peaks_of_flat_belief_return_given_yaw():
    assert make_grid().yaw_peaks(np.array([0.45, 0.0, 1.0]), 3) == [1.0]


PLACE = (0.45, 0.02, 0.5)


@pytest.mark.parametrize("count", [1, 2, 7])
def test_nth_image_of_one_state_weighs_one_nth(count):
    weights = EvidenceWeights(SETTINGS).update(np.tile(PLACE, (count, 1)))
    np.testing.assert_allclose(weights, 1.0 / np.arange(1, count + 1))


def test_distant_images_have_full_weight():
    states = np.array([PLACE, (0.52, 0.02, 0.5), (0.45, -0.05, 0.5), (0.45, 0.02, -1.0)])
    np.testing.assert_allclose(EvidenceWeights(SETTINGS).update(states), 1.0, atol=1e-6)


@pytest.mark.parametrize("step", [(0.01, 0.0, 0.0), (0.0, -0.01, 0.0), (0.0, 0.0, 0.2)])
def test_image_at_independence_length_shares_weight(step):
    weights = EvidenceWeights(SETTINGS).update(np.array([PLACE, np.add(PLACE, step)]))
    np.testing.assert_allclose(weights, [1.0, 1.0 / (1.0 + math.exp(-0.5))])


def test_evidence_weight_wraps_yaw():
    states = np.array([(0.45, 0.0, math.pi - 0.001), (0.45, 0.0, -math.pi + 0.001)])
    np.testing.assert_allclose(EvidenceWeights(SETTINGS).update(states), [1.0, 0.5], atol=1e-4)


@settings(max_examples=25)
@given(st.integers(0, 2**31 - 1), st.lists(st.integers(0, 30), max_size=4))
def test_result_independent_of_stream_chunks(seed, cuts):
    states = np.random.default_rng(seed).uniform((0.44, 0.0, -0.4), (0.48, 0.04, 0.4), (30, 3))
    stream = EvidenceWeights(SETTINGS)
    parts = [stream.update(part) for part in np.split(states, sorted(cuts))]
    np.testing.assert_allclose(np.concatenate(parts), EvidenceWeights(SETTINGS).update(states), rtol=1e-12)


def test_counted_evidence_has_full_weight():
    stream = EvidenceWeights(replace(SETTINGS, evidence="counted"))
    np.testing.assert_array_equal(stream.update(np.tile(PLACE, (5, 1))), np.ones(5))
    np.testing.assert_array_equal(stream.update(np.tile(PLACE, (2, 1))), np.ones(2))
