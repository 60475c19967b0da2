"""Tables about identification."""

import numpy as np
import pytest

from embodied_active_learning.evaluation.identification_tables import HEADER, outcome, outcome_table, share


def row(**changes):
    """A hit of a duck on the table that its session learned."""
    values = {
        "condition": "noise", "scene": "0", "session": "a", "kind": "duck", "own_table": "1", "present": "1",
        "hit": "1", "false_claim": "0", "undecided": "0", "error": "0.01",
    }  # fmt: skip
    return {**values, **changes}


def test_two_fingerprints_of_one_kind_count_once_as_hit():
    hits = outcome([row(hit="0", undecided="1"), row()]).hits
    assert (hits.count, hits.total) == (1, 1)


def test_kinds_in_two_scenes_count_twice():
    assert outcome([row(), row(scene="1")]).hits.total == 2


def test_hit_needs_the_own_table_where_a_table_was_learned():
    assert outcome([row(own_table="0")]).hits is None


@pytest.mark.parametrize("condition", ["other table", "all"])
def test_hit_counts_on_tables_that_nobody_learned(condition):
    assert outcome([row(own_table="0", condition=condition)]).hits.total == 1


def test_each_wrong_place_counts():
    wrong = outcome([row(false_claim="1"), row(false_claim="1", hit="0")]).wrong_places
    assert (wrong.count, wrong.total) == (2, 2)


def test_claims_of_absent_kinds_are_no_wrong_places():
    result = outcome([row(present="0", hit="0", false_claim="1", error="nan")])
    assert (result.hits, result.wrong_places, result.error) == (None, None, None)
    assert (result.false_claims.count, result.false_claims.total) == (1, 1)


def test_error_is_the_median_of_hits():
    assert outcome([row(scene=str(i), error=str(e)) for i, e in enumerate([0.0, 0.01, 0.03])]).error == 0.01


def test_share_without_spread_has_the_exact_interval():
    found = share([row(session=name) for name in "abc"], "hit")
    assert found.high == 1.0
    assert found.low == pytest.approx(0.025 ** (1.0 / 3.0))  # Clopper and Pearson


def test_interval_of_share_spans_the_sessions():
    found = share([row(session=name, hit=hit) for name, hit in zip("abcd", "1110")], "hit")
    assert found.low < found.count / found.total < found.high
    assert np.isclose(found.count / found.total, 0.75)


def test_table_omits_groups_without_rows():
    lines = outcome_table("condition", {"noise": [row()], "shadow": []})
    assert len(lines) == 3
    assert lines[2] == "| noise | 1 / 1 (2-100 %) | 0 / 1 | 0 / 1 | - | - | 1.00 |"
    assert all(name in lines[0] for name in HEADER)
