"""Means and intervals over the seeds of runs."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ConfigError, SessionError
from embodied_active_learning.sweep import compare_sessions
from embodied_active_learning.sweep.compare_sessions import main
from embodied_active_learning.sweep.comparison import (
    bootstrap_mean,
    clustering_settings,
    compare_columns,
    group_records,
    load_records,
)
from embodied_active_learning.sweep.csv_files import read_rows, write_rows
from embodied_active_learning.sweep.record_figures import render_top_view
from embodied_active_learning.sweep.run_records import load_record, write_record
from sample_records import make_record

RECORDS = [
    make_record("a", "ergodic", 1.0),
    make_record("b", "ergodic", 3.0, seed=1),
    make_record("c", "uniform", 5.0),
]


@given(st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=8))
def test_bootstrap_interval_has_mean_and_stays_within_data(values):
    result = bootstrap_mean(np.array(values)[:, np.newaxis], range(len(values)))
    spread = 1e-9 * (1.0 + np.abs(values).max())
    assert min(values) - spread <= result.low[0] <= result.high[0] <= max(values) + spread
    assert result.mean[0] == pytest.approx(np.mean(values))


def test_bootstrap_interval_covers_the_true_mean():
    """Of 200 samples of 20 normal numbers, about 93 % of the intervals cover it."""
    samples = np.random.default_rng(1).normal(3.0, 1.0, (20, 200))
    result = bootstrap_mean(samples, range(len(samples)))
    assert np.mean((result.low < 3.0) & (result.high > 3.0)) == pytest.approx(0.93, abs=0.05)


def test_one_seed_has_no_interval():
    result = bootstrap_mean(np.array([[1.0, 2.0], [3.0, 4.0]]), [7, 7])
    assert list(result.mean) == [2.0, 3.0]
    assert np.isnan(result.low).all()


def test_runs_of_a_seed_are_averaged_before_seeds_are_resampled():
    result = bootstrap_mean(np.array([[0.0], [3.0], [4.0], [5.0]]), [1, 2, 1, 2])
    assert (result.mean[0], result.low[0], result.high[0]) == (3.0, 2.0, 4.0)


def test_columns_are_averaged_per_group():
    curves = compare_columns(group_records(RECORDS, "exploration/explorer"))
    ergodic, uniform = curves["training", "loss"]
    assert (ergodic.label, ergodic.mean[-1]) == ("ergodic (n = 2)", 2.0)
    assert (ergodic.low[-1], ergodic.high[-1]) == (1.0, 3.0)
    assert uniform.mean[-1] == 5.0
    assert ("exploration", "x") not in curves


def test_runs_are_compared_up_to_the_shortest():
    groups = {"all": [make_record("a", "ergodic", 1.0, 100), make_record("b", "ergodic", 1.0, 50)]}
    assert compare_columns(groups)["training", "loss"][0].x[-1] == 50.0


def test_runs_without_common_rows_have_no_curve():
    early, late = make_record("a", "ergodic", 1.0, 50), make_record("b", "ergodic", 1.0, 100)
    late.tables["training"] = {name: values[60:] for name, values in late.tables["training"].items()}
    assert ("training", "loss") not in compare_columns({"all": [early, late]})


def test_clustering_settings_that_differ_are_named():
    assert clustering_settings(RECORDS) == ""
    config = Config.from_dict({"fingerprint": {"min_share": 0.05}})
    changed = replace(RECORDS[0], config=config)
    setting = "Objects were clustered with `fingerprint/min_share`"
    default = Config().fingerprint.min_share
    assert clustering_settings([changed, changed]) == f"{setting} 0.05 (default {default})."
    both = f"0.05 (1 of 3 runs), {default} (2 of 3 runs)"
    assert clustering_settings([changed, *RECORDS[1:]]) == f"{setting} {both} (default {default})."


def test_unknown_key_is_refused():
    with pytest.raises(ConfigError, match="did you mean exploration/explorer"):
        group_records(RECORDS, "exploration/explore")
    with pytest.raises(ConfigError, match="cannot be grouped by session/name"):
        group_records(RECORDS, "session/name")


def test_record_is_written_small_and_read_again(tmp_path):
    write_record(tmp_path / "a", make_record("a", "uniform", 2.0, 3000))
    record = load_record(tmp_path / "a")
    assert (record.name, record.variant, record.config.exploration.explorer) == ("a", "uniform", "uniform")
    steps = record.tables["exploration"]["step"]
    assert (len(steps), steps[0], steps[-1]) == (300, 1.0, 3000.0)
    assert sum(path.stat().st_size for path in (tmp_path / "a").iterdir()) < 90_000


def test_command_writes_table_and_csv(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(
        compare_sessions, "draw_curves", lambda path, panels, axes: path if set(panels) == set(axes) else None
    )
    for record in RECORDS:
        write_record(tmp_path / "results" / record.name, record)
    assert main([str(tmp_path / "results"), "--output", str(tmp_path / "out")]) == 0
    assert "| evaluation/mse_own | ergodic (n = 2) | 2 | 1 to 3 |" in capsys.readouterr().out
    with (tmp_path / "out" / "comparison.csv").open(encoding="utf-8") as stream:
        row = next(csv.DictReader(stream))
    assert (row["table"], row["column"], row["group"]) == ("exploration", "ergodic_measure", "ergodic (n = 2)")


def test_panels_have_units_and_more_than_one_row():
    record = make_record("a", "ergodic", 1.0)
    record.tables["evaluation"] = {name: values[-1:] for name, values in record.tables["evaluation"].items()}
    panels, axes = compare_sessions._panels(compare_columns({"a": [record]}))
    assert axes["ergodic_measure\n[nat]"] == "step"
    assert "gamma" in panels
    assert "mse_own" not in panels


def test_command_names_settings_that_a_group_mixes(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(compare_sessions, "draw_curves", lambda path, panels, axes: path)
    for name, explorer in (("a", "ergodic"), ("b", "uniform")):
        write_record(tmp_path / name, replace(make_record(name, explorer, 1.0), variant=""))
    assert main([str(tmp_path / "a"), str(tmp_path / "b"), "--output", str(tmp_path)]) == 0
    assert "runs of one group differ in exploration/explorer: see --by" in capsys.readouterr().out


def test_command_refuses_what_is_no_folder(tmp_path, capsys):
    assert main([str(tmp_path / "kitchen")]) == 2
    assert "kitchen: give the folder of a session" in capsys.readouterr().err


def test_command_refuses_folder_without_run(tmp_path, capsys):
    assert main([str(tmp_path)]) == 2
    assert "config.yaml is missing" in capsys.readouterr().err
    with pytest.raises(SessionError, match="no run to compare"):
        load_records([])


def test_rows_are_written_and_read_again(tmp_path):
    write_rows(tmp_path / "new" / "rows.csv", [{"name": "a,b", "value": 1 / 3, "none": None, "nan": float("nan")}])
    assert read_rows(tmp_path / "new" / "rows.csv") == [{"name": "a,b", "value": "0.333333", "none": "", "nan": ""}]


def test_world_of_a_record_is_rendered():
    record = make_record("a", "ergodic", 1.0)
    view = render_top_view(record)
    assert view.pixels.std() > 10.0
    assert view.extent[0] < record.config.workspace.x[0] < record.config.workspace.x[1] < view.extent[1]
