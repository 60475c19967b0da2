"""Belief grids follow Bayes' rule cell by cell, and images from one place share the weight of one."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from embodied_active_learning.config import IdentificationConfig
from embodied_active_learning.objects.beliefs import BeliefGrid, EvidenceWeights
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


def make_grid(**values):
    return BeliefGrid(WORKSPACE, replace(SETTINGS, **values))


def measure(grid, *measurements):
    """Update with (pose, value) or (pose, value, weight)."""
    for pose, value, *weight in measurements:
        grid.update(np.array([pose]), np.array([value]), np.array(weight or [1.0]))
    return grid


def cell_of(grid, x, y, yaw):
    """Indices of the cell whose middle is nearest."""
    return tuple(int(np.abs(axis - value).argmin()) for axis, value in zip((grid.x, grid.y, grid.yaw), (x, y, yaw)))


def middle_of(grid, index):
    return np.array([grid.x[index[0]], grid.y[index[1]], grid.yaw[index[2]]])


def textbook(grid, prior_mean, prior_variance, pose, value, settings_=SETTINGS, weight=1.0):
    """Product of the Gaussian belief of each cell with that of a measurement whose pose is the middle of a cell.

    r(s) = far + K(s) (near - far), with near_variance at the pose and far_pull of its information far away.
    """
    mean, variance = np.empty(prior_mean.shape), np.empty(prior_mean.shape)
    near, far = settings_.near_variance, settings_.near_variance / settings_.far_pull
    for index in np.ndindex(mean.shape):
        dx, dy, dyaw = middle_of(grid, index) - pose
        dyaw = math.atan2(math.sin(dyaw), math.cos(dyaw))
        footprint = math.exp(
            -0.5 * ((dx**2 + dy**2) / settings_.kernel_std**2 + (dyaw / settings_.kernel_yaw_std) ** 2)
        )
        r = (far + footprint * (near - far)) / weight
        m, v = prior_mean[index], prior_variance[index]
        mean[index] = (m * r + value * v) / (v + r)
        variance[index] = v * r / (v + r)
    return mean, variance


def test_nothing_is_believed_before_the_first_image():
    grid = make_grid()
    assert grid.mean.shape == grid.std.shape == (20, 16, 12)
    np.testing.assert_allclose(grid.mean, 0.5)
    np.testing.assert_allclose(grid.std, math.sqrt(2.0))


def test_cells_reach_over_the_margin_and_around_the_circle():
    grid = make_grid(margin=0.02)
    np.testing.assert_allclose(grid.x[[0, -1]], (0.305, 0.645))
    np.testing.assert_allclose(grid.y[[0, -1]], (-0.17, 0.17))
    width = 2.0 * math.pi / 12
    np.testing.assert_allclose(grid.yaw, -math.pi + width * (np.arange(12) + 0.5))


@pytest.mark.parametrize(("index", "value"), [((4, 9, 2), 0.9), ((0, 15, 11), 0.1), ((19, 0, 0), 1.0)])
def test_one_measurement_changes_each_cell_by_bayes_rule(index, value):
    grid = make_grid()
    pose = middle_of(grid, index)
    mean, variance = textbook(grid, grid.mean, grid.std**2, pose, value)
    measure(grid, (pose, value))
    np.testing.assert_allclose(grid.mean, mean, rtol=1e-9)
    np.testing.assert_allclose(grid.std, np.sqrt(variance), rtol=1e-9)


def test_a_second_measurement_is_multiplied_to_what_the_first_has_left():
    grid = make_grid()
    mean, variance = grid.mean, grid.std**2
    for index, value, weight in (((4, 9, 2), 0.9, 1.0), ((6, 8, 1), 0.3, 0.5)):
        pose = middle_of(grid, index)
        mean, variance = textbook(grid, mean, variance, pose, value, weight=weight)
        measure(grid, (pose, value, weight))
    np.testing.assert_allclose(grid.mean, mean, rtol=1e-9)
    np.testing.assert_allclose(grid.std, np.sqrt(variance), rtol=1e-9)


def test_at_the_pose_a_measurement_has_the_near_variance_wherever_in_its_cell_it_lies():
    grid = make_grid()
    index = (7, 5, 3)
    off = np.array([0.4 * (grid.x[1] - grid.x[0]), -0.4 * (grid.y[1] - grid.y[0]), 0.2])
    measure(grid, (middle_of(grid, index) + off, 1.0))
    expected = (0.5 / 2.0 + 1.0 / SETTINGS.near_variance) / (1.0 / 2.0 + 1.0 / SETTINGS.near_variance)
    assert grid.mean[index] == pytest.approx(expected, rel=1e-9)
    assert np.unravel_index(grid.mean.argmax(), grid.mean.shape) == index


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 50), st.integers(0, 2**31 - 1))
def test_several_measurements_at_once_are_like_one_after_the_other(count, seed):
    """On the grid and outside of it, fewer and more of them than are taken at a time."""
    random = np.random.default_rng(seed)
    poses = random.uniform((0.2, -0.3, -math.pi), (0.75, 0.3, math.pi), (count, 3))
    values, weights = random.uniform(0, 1, (2, count))
    together, apart = make_grid(), make_grid()
    together.update(poses, values.astype(np.float32), weights)
    measure(apart, *zip(poses, values.astype(np.float32), weights))
    np.testing.assert_allclose(together.mean, apart.mean, rtol=1e-12)
    np.testing.assert_allclose(together.std, apart.std, rtol=1e-12)


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 40), st.integers(0, 2**31 - 1))
def test_what_many_measurements_add_is_the_sum_of_what_each_tells_each_cell(count, seed):
    random = np.random.default_rng(seed)
    poses = random.uniform((0.2, -0.3, -math.pi), (0.75, 0.3, math.pi), (count, 3))
    values, weights = random.uniform(0, 1, (2, count))
    grid = make_grid()
    information = np.full(grid.mean.shape, 0.5)
    weighted = 0.5 * information
    for pose, value, weight in zip(poses, values, weights):
        told = weight * plain_information(grid, pose)
        information += told
        weighted += told * value
    grid.update(poses, values, weights)
    np.testing.assert_allclose(grid.mean, weighted / information, rtol=1e-12)
    np.testing.assert_allclose(grid.std, 1.0 / np.sqrt(information), rtol=1e-12)


def plain_information(grid, pose):
    """1 / r of the docstring of update, for one pose and the full grid."""
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


@settings(max_examples=25, deadline=None)
@given(MEASUREMENTS, st.randoms(use_true_random=False))
def test_the_order_of_images_does_not_matter(measurements, random):
    shuffled = random.sample(measurements, len(measurements))
    grids = [make_grid(), make_grid()]
    for grid, items in zip(grids, (measurements, shuffled)):
        measure(grid, *((item[:3], item[3], item[4]) for item in items))
    np.testing.assert_allclose(grids[0].mean, grids[1].mean, rtol=1e-9)
    np.testing.assert_allclose(grids[0].std, grids[1].std, rtol=1e-9)


@settings(max_examples=25, deadline=None)
@given(MEASUREMENTS)
def test_means_stay_between_0_and_1_and_every_measurement_makes_every_cell_surer(measurements):
    grid = make_grid()
    for item in measurements:
        before = grid.std
        measure(grid, (item[:3], item[3], item[4]))
        assert np.all(grid.std < before)
        assert np.all((grid.mean >= 0.0) & (grid.mean <= 1.0))


def test_yaw_has_no_border():
    above, below, opposite = (
        measure(make_grid(), ((0.45, 0.0, yaw), 1.0)) for yaw in (math.pi - 0.01, -math.pi + 0.01, 0.0)
    )
    np.testing.assert_allclose(above.mean, below.mean, atol=0.03)
    assert np.abs(above.mean - opposite.mean).max() > 0.3
    mean = above.mean[cell_of(above, 0.45, 0.0, 0.0)[:2]]
    assert mean[0] == pytest.approx(mean[-1], abs=0.03)
    assert mean[0] > mean[1] > mean[2]
    assert mean[-1] > mean[-2] > mean[-3]


def test_any_turn_more_makes_no_difference():
    once, thrice = (measure(make_grid(), ((0.45, 0.0, yaw), 1.0)) for yaw in (0.7, 0.7 + 4 * math.pi))
    np.testing.assert_allclose(once.mean, thrice.mean, rtol=1e-9)


@pytest.mark.parametrize("pose", [(0.72, 0.0, 0.0), (0.21, 0.1, 0.0), (0.4, 0.26, 1.0), (0.4, -0.5, 1.0)])
def test_a_pose_outside_the_grid_pulls_all_cells_only_weakly(pose):
    pulled, inside = measure(make_grid(), (pose, 1.0)).mean, measure(make_grid(), ((0.45, 0.0, 0.0), 1.0)).mean
    assert inside.max() > 0.95
    assert 0.5 < pulled.min() <= pulled.max() < 0.65


@pytest.mark.parametrize("beyond", [0.001, 0.01, 0.03, 0.06])
def test_the_border_next_to_a_pose_outside_the_grid_is_not_taken_for_that_pose(beyond):
    grid = make_grid()
    index = (19, 8, 6)
    pose = np.add(middle_of(grid, index), (beyond, 0.0, 0.0))
    mean, _ = textbook(grid, grid.mean, grid.std**2, pose, 1.0)
    measure(grid, (pose, 1.0))
    np.testing.assert_allclose(grid.mean, mean, rtol=1e-9)


@pytest.mark.parametrize("far_pull", [0.001, 0.02, 0.5])
def test_unseen_cells_are_drawn_by_the_far_pull(far_pull):
    grid = measure(make_grid(far_pull=far_pull), ((0.33, -0.14, 0.0), 1.0))
    information = far_pull / SETTINGS.near_variance
    unseen = grid.mean[cell_of(grid, 0.62, 0.14, 3.0)]
    assert unseen == pytest.approx((0.25 + information) / (0.5 + information), rel=1e-6)


def test_with_a_far_pull_of_1_every_cell_takes_every_measurement_in_full():
    grid = measure(make_grid(far_pull=1.0), ((0.33, -0.14, 0.0), 1.0))
    np.testing.assert_allclose(grid.mean, grid.mean[0, 0, 0])


def test_half_a_weight_is_half_the_information():
    pose = (0.45, 0.03, 0.2)
    halves = measure(make_grid(), (pose, 0.8, 0.5), (pose, 0.8, 0.5))
    whole = measure(make_grid(), (pose, 0.8, 1.0))
    np.testing.assert_allclose(halves.mean, whole.mean, rtol=1e-12)
    np.testing.assert_allclose(halves.std, whole.std, rtol=1e-12)


def test_over_yaw_is_the_best_yaw_at_each_place_with_its_own_uncertainty():
    grid = measure(make_grid(), ((0.45, 0.0, 1.0), 1.0), ((0.45, 0.0, -1.0), 0.0), ((0.55, 0.05, 2.0), 0.7))
    mean, std = grid.over_yaw()
    for row, column in np.ndindex(20, 16):
        best = grid.mean[row, column].argmax()
        assert mean[row, column] == grid.mean[row, column, best]
        assert std[row, column] == grid.std[row, column, best]


PLACES = ((0.38, -0.08, -1.2), (0.55, 0.07, 2.9), (0.45, 0.10, 0.3))


def peaked(**values):
    return measure(make_grid(cells=(40, 40, 18), **values), *zip(PLACES, (0.8, 1.0, 0.9)))


def test_peaks_are_where_measurements_point_the_highest_first():
    grid = peaked()
    found = grid.peaks(0.06, 12)
    for (pose, mean, std, _), expected in zip(found, (PLACES[1], PLACES[2], PLACES[0])):
        assert np.abs(pose[:2] - expected[:2]).max() <= 0.5 * (grid.x[1] - grid.x[0]) + 1e-9
        assert abs(pose[2] - expected[2]) <= math.pi / 18 + 1e-9
        index = cell_of(grid, *pose)
        assert mean == grid.mean[index] == grid.mean[index[:2]].max()
        assert std == pytest.approx(grid.std[index])
    means = [mean for _, mean, _, _ in found]
    assert [rise for _, _, _, rise in found] == pytest.approx([mean - np.median(grid.over_yaw()[0]) for mean in means])
    assert means == sorted(means, reverse=True)


@pytest.mark.parametrize("distance", [0.03, 0.06, 0.15])
def test_no_two_peaks_are_closer_than_asked_for(distance):
    poses = np.array([pose for pose, _, _, _ in peaked().peaks(distance, 1000)])
    apart = np.linalg.norm(poses[:, None, :2] - poses[:, :2], axis=2) + 10.0 * np.eye(len(poses))
    assert len(poses) >= 2
    assert apart.min() >= distance


def test_of_two_peaks_that_are_too_close_the_higher_stays():
    grid = measure(make_grid(cells=(40, 40, 18)), ((0.45, 0.0, 0.0), 0.9), ((0.53, 0.0, 0.0), 1.0))
    places = [pose[0] for pose, _, _, _ in grid.peaks(0.05, 2)]
    assert places == pytest.approx([0.53, 0.45], abs=0.006)
    found = grid.peaks(0.12, 100)
    assert found[0][0][0] == pytest.approx(0.53, abs=0.006)
    assert all(abs(pose[0] - 0.45) > 0.01 for pose, _, _, _ in found)


@pytest.mark.parametrize("most", [1, 2, 5])
def test_no_more_peaks_than_asked_for(most):
    assert len(peaked().peaks(0.06, most)) == min(most, len(PLACES))
    assert len(make_grid().peaks(0.06, most)) == most


def test_peaks_lie_inside_the_workspace_and_not_in_the_margin():
    grid = measure(make_grid(cells=(40, 40, 18), margin=0.05), ((0.66, 0.0, 0.0), 1.0), ((0.45, 0.1, 0.0), 0.8))
    found = grid.peaks(0.06, 100)
    assert all(WORKSPACE.contains([*pose[:2], 0.0]) for pose, _, _, _ in found)
    assert found[0][0][:2] == pytest.approx((0.45, 0.1), abs=0.006)


def test_at_the_border_a_peak_counts_though_the_belief_is_higher_beyond_it():
    grid = measure(make_grid(cells=(40, 40, 18), margin=0.05), ((0.645, 0.05, 0.0), 1.0), ((0.45, 0.05, 0.0), 0.0))
    pose, _, _, _ = grid.peaks(0.06, 1)[0]
    assert pose[:2] == pytest.approx((0.62, 0.05), abs=0.011)


def test_peaks_may_have_a_yaw_that_the_camera_cannot_take():
    pose, _, _, _ = measure(make_grid(cells=(40, 40, 18)), ((0.45, 0.0, 3.0), 1.0)).peaks(0.06, 1)[0]
    assert pose[2] == pytest.approx(3.0, abs=math.pi / 18)


def test_yaws_of_a_place_are_the_maxima_around_the_circle_the_highest_first():
    grid = measure(
        make_grid(cells=(40, 40, 18)), ((0.45, 0.0, 3.1), 0.9), ((0.45, 0.0, 0.3), 1.0), ((0.45, 0.0, -1.5), 0.8)
    )
    width = 2.0 * math.pi / 18
    found = grid.yaws(np.array([0.452, 0.003, 1.0]), 3)
    assert found == pytest.approx([0.3, 3.1, -1.5], abs=0.5 * width)
    assert grid.yaws(np.array([0.452, 0.003, 1.0]), 2) == found[:2]


def test_a_place_of_which_no_yaw_is_known_keeps_its_own():
    assert make_grid().yaws(np.array([0.45, 0.0, 1.0]), 3) == [1.0]


PLACE = (0.45, 0.02, 0.5)


@pytest.mark.parametrize("count", [1, 2, 7])
def test_images_from_one_place_count_1_and_a_half_and_a_third(count):
    weights = EvidenceWeights(SETTINGS).of(np.tile(PLACE, (count, 1)))
    np.testing.assert_allclose(weights, 1.0 / np.arange(1, count + 1))


def test_images_from_places_far_apart_count_fully():
    states = np.array([PLACE, (0.52, 0.02, 0.5), (0.45, -0.05, 0.5), (0.45, 0.02, -1.0)])
    np.testing.assert_allclose(EvidenceWeights(SETTINGS).of(states), 1.0, atol=1e-6)


@pytest.mark.parametrize("step", [(0.01, 0.0, 0.0), (0.0, -0.01, 0.0), (0.0, 0.0, 0.2)])
def test_an_image_one_independence_length_away_shares_part_of_the_weight(step):
    weights = EvidenceWeights(SETTINGS).of(np.array([PLACE, np.add(PLACE, step)]))
    np.testing.assert_allclose(weights, [1.0, 1.0 / (1.0 + math.exp(-0.5))])


def test_a_full_turn_away_is_the_same_place():
    states = np.array([(0.45, 0.0, math.pi - 0.001), (0.45, 0.0, -math.pi + 0.001)])
    np.testing.assert_allclose(EvidenceWeights(SETTINGS).of(states), [1.0, 0.5], atol=1e-4)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**31 - 1), st.lists(st.integers(0, 30), max_size=4))
def test_it_makes_no_difference_in_which_parts_the_stream_comes(seed, cuts):
    states = np.random.default_rng(seed).uniform((0.44, 0.0, -0.4), (0.48, 0.04, 0.4), (30, 3))
    stream = EvidenceWeights(SETTINGS)
    parts = [stream.of(part) for part in np.split(states, sorted(cuts))]
    np.testing.assert_allclose(np.concatenate(parts), EvidenceWeights(SETTINGS).of(states), rtol=1e-12)


def test_counted_images_all_count_fully():
    stream = EvidenceWeights(replace(SETTINGS, evidence="counted"))
    np.testing.assert_array_equal(stream.of(np.tile(PLACE, (5, 1))), np.ones(5))
    np.testing.assert_array_equal(stream.of(np.tile(PLACE, (2, 1))), np.ones(2))
