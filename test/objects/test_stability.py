"""The stopping criterion on given measurements."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from embodied_active_learning.objects.stability import (
    EMPTY_CHECKS,
    MAX_DRIFT,
    STABLE_CHECKS,
    Measurement,
    StoppingCriterion,
    largest_distance,
    unexplained,
)

TWO = np.array([[0.40, 0.0], [0.52, 0.1]])
GOOD = Measurement(150, 114, TWO, 0, 8.0, 0.9, 0.8)


def checks(*measurements):
    criterion = StoppingCriterion()
    return [criterion.add(measurement) for measurement in measurements]


def test_stable_useful_covered_objects_end_the_run():
    results = checks(*[GOOD] * STABLE_CHECKS)
    assert [check.stopped for check in results] == [False] * (STABLE_CHECKS - 1) + [True]
    assert results[-1].reason == "objects stable"
    assert results[-1].drift == 0.0


@pytest.mark.parametrize(
    "missing",
    [
        {"undiscovered": 1},
        {"latent_contribution": 0.4},
        {"latent_contribution": float("nan")},
        {"coverage": 0.5},
    ],
)
def test_each_part_is_needed(missing):
    assert not checks(*[replace(GOOD, **missing)] * 2 * EMPTY_CHECKS)[-1].stopped


def test_thing_seen_between_empty_checks_delays_the_end():
    empty = replace(GOOD, centres=np.empty((0, 2)))
    results = checks(*[empty] * (EMPTY_CHECKS - 1), replace(empty, undiscovered=1), *[empty] * EMPTY_CHECKS)
    assert [check.stopped for check in results[-2:]] == [False, True]


def test_new_object_starts_the_count_anew():
    results = checks(*[replace(GOOD, centres=TWO[:1])] * STABLE_CHECKS, *[GOOD] * (STABLE_CHECKS - 1))
    assert results[STABLE_CHECKS].stable_checks == 1
    assert np.isnan(results[STABLE_CHECKS].drift)
    assert not results[-1].stopped


def test_slow_drift_is_not_stable():
    """Each check is close to the one before, but not to all."""
    shift = np.array([0.6 * MAX_DRIFT, 0.0])
    results = checks(*[replace(GOOD, centres=TWO + i * shift) for i in range(2 * STABLE_CHECKS)])
    assert not any(check.stopped for check in results)
    assert results[-1].stable_checks == 2


def test_order_of_objects_is_irrelevant():
    results = checks(*[replace(GOOD, centres=TWO[::direction]) for direction in (1, -1) * STABLE_CHECKS])
    assert results[STABLE_CHECKS - 1].stopped


def test_empty_table_ends_without_a_useful_latent():
    empty = replace(GOOD, centres=np.empty((0, 2)), latent_contribution=0.0)
    results = checks(*[empty] * EMPTY_CHECKS)
    assert [check.stopped for check in results] == [False] * (EMPTY_CHECKS - 1) + [True]
    assert results[-1].reason == "nothing to learn"
    assert "objects 0 for 6/6 checks  undiscovered 0  coverage" in results[-1].describe()


def test_visible_thing_without_cluster_prevents_an_empty_table():
    seen = replace(GOOD, centres=np.empty((0, 2)), undiscovered=1)
    assert not checks(*[seen] * 2 * EMPTY_CHECKS)[-1].stopped


@given(st.lists(st.integers(0, 2), min_size=1, max_size=12), st.integers(0, 12))
def test_restored_criterion_continues_like_the_original(counts, restart):
    measurements = [replace(GOOD, centres=TWO[:count]) for count in counts]
    criterion, results = StoppingCriterion(), []
    for index, measurement in enumerate(measurements):
        if index == restart:
            state = json.loads(json.dumps(criterion.state_dict()))
            criterion = StoppingCriterion()
            criterion.load_state_dict(state)
        results.append(criterion.add(measurement))
    assert list(map(repr, results)) == list(map(repr, checks(*measurements)))


def test_distances_between_sets_of_points():
    assert largest_distance(TWO, TWO[::-1] + np.array([0.0, 0.02])) == pytest.approx(0.02)
    assert largest_distance(np.empty((0, 2)), np.empty((0, 2))) == 0.0
    assert np.isnan(largest_distance(TWO, TWO[:1]))
    assert unexplained(np.array([[0.4, 0.03], [0.6, -0.1]]), TWO, 0.05).tolist() == [[0.6, -0.1]]
    assert len(unexplained(TWO, np.empty((0, 2)), 0.05)) == 2
    assert len(unexplained(np.empty((0, 2)), TWO, 0.05)) == 0
