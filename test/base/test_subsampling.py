"""Evenly spread indices."""

import pytest

from embodied_active_learning.subsampling import spread_indices


@pytest.mark.parametrize(
    ("count", "most", "expected"), [(0, 3, []), (1, 3, [0]), (3, 5, [0, 1, 2]), (9, 3, [0, 4, 8]), (5, 1, [0])]
)
def test_indices_reach_from_first_to_last(count, most, expected):
    assert spread_indices(count, most).tolist() == expected
