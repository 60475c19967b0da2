"""Tables and curves of results, and the blocks of the page they are written to."""

import numpy as np
import pytest

from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.evaluation.result_tables import (
    folded,
    group_table,
    interval,
    last_value,
    mean_table,
    replace_block,
    row_curves,
    run_table,
    stays_below,
    summary_value,
)
from launching import ROOT
from sample_records import make_record

ROWS = [
    {"method": "a", "steps": "20", "value": "4.0", "seed": "0"},
    {"method": "a", "steps": "10", "value": "1.0", "seed": "0"},
    {"method": "a", "steps": "10", "value": "3.0", "seed": "1"},
    {"method": "b", "steps": "10", "value": "5.0", "seed": "0"},
]


def test_interval_of_values():
    assert interval([], []) == "-"
    assert (
        interval([0.12345], [0]) == interval([0.12345, 0.12345], [0, 1]) == interval([0.1, 0.1469], [1, 1]) == "0.123"
    )
    assert interval([1.0, 3.0], [0, 1]) == "2 (1 to 3)"
    assert interval([1234.5], [0]) == "1234"


def test_mean_table_has_a_line_for_each_group():
    assert mean_table(ROWS, "method", "steps", "value") == [
        "| method | steps 10 | steps 20 |",
        "| --- | --- | --- |",
        "| a | 2 (1 to 3) | 4 |",
        "| b | 5 | - |",
    ]


def test_row_curves_average_rows_with_the_same_x():
    first, second = row_curves(ROWS, "method", "steps", "value")
    assert (first.label, list(first.x), list(first.mean)) == ("a", [10.0, 20.0], [2.0, 4.0])
    assert second.label == "b"
    assert np.isnan(second.low).all()


def test_run_table_shows_the_end_of_a_run():
    line = run_table([make_record("a", "ergodic", 1.0)])[-1]
    assert line.startswith("| ergodic | diagonal | 0 | 100 | 0.755 |")


def test_group_table_states_how_many_runs_have_a_value():
    """The columns rise from 0.01 to 1 and from 0.03 to 3 in 100 steps."""
    groups = {"a": [make_record("a", "ergodic", 1.0), make_record("b", "ergodic", 3.0, seed=1)]}
    measures = {"below": stays_below("exploration", "coverage", 2.0), "last": last_value("evaluation", "mse_own")}
    assert group_table(groups, measures)[-1] == "| a | 2 | 1; 1 of 2 runs | 2 (1 to 3) |"
    assert group_table(groups, {"distance": summary_value("distance")})[-1] == "| a | 2 | - |"


@pytest.mark.parametrize(
    ("values", "step"),
    [
        ([3, 1, 3, 1, 1], 4.0),
        ([1, 1, 1, 1, 1], 1.0),
        ([1, 1, 1, 1, 2], None),
        ([1, 3, 3, 3, 1], None),  # by chance
        ([np.nan] * 5, None),
    ],
)
def test_first_step_from_which_a_column_stays_below_a_limit(values, step):
    record = make_record("a", "ergodic", 1.0, steps=5)
    record.tables["exploration"]["ergodic_measure"] = np.array(values)
    assert stays_below("exploration", "ergodic_measure", 2.0)(record) == step


def test_last_value_that_is_not_a_number_counts_as_missing():
    record = make_record("a", "uniform", 1.0)
    record.tables["exploration"]["effort"][-1] = np.nan
    assert last_value("exploration", "effort")(record) is None


def test_block_is_replaced(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- one -->\nold\n<!-- end -->\nafter\n", encoding="utf-8")
    replace_block(page, "one", ["new", "lines"])
    assert page.read_text(encoding="utf-8") == "before\n<!-- one -->\nnew\nlines\n<!-- end -->\nafter\n"
    with pytest.raises(CorruptFileError, match="has no block <!-- two -->"):
        replace_block(page, "two", [])


def test_page_has_the_blocks_of_all_results():
    text = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    assert [
        name
        for name in ("learning_metrics", "ablations", "ablation_models", "curated_objects", "coverage")
        if f"<!-- {name} -->" not in text
    ] == []


def test_folded_table_is_separated_from_html_by_empty_lines():
    assert folded("all", ["| a |"]) == ["<details>", "<summary>all</summary>", "", "| a |", "", "</details>"]
