"""The file of a sweep and its runs."""

import pytest

from embodied_active_learning.errors import ConfigError, SessionError, WorldError
from embodied_active_learning.sweep.spec import check_worlds, differences, load_sweep
from launching import ROOT

SPEC = """
worlds: [bottom, right]
seeds: [4, 7]
overrides: {exploration: {steps: 300}}
variants:
  ergodic: {}
  walk: {worlds: [right], overrides: {exploration: {explorer: random_walk}}}
"""


def load(tmp_path, text):
    path = tmp_path / "small.yaml"
    path.write_text(text, encoding="utf-8")
    return load_sweep(path)


def test_runs_are_all_combinations_with_first_seed_first(tmp_path):
    sweep = load(tmp_path, SPEC)
    assert sweep.name == "small"
    assert [run.name for run in sweep.runs] == [
        f"{run}-seed{seed}" for seed in (4, 7) for run in ("ergodic-bottom", "ergodic-right", "walk-right")
    ]


def test_run_combines_profile_and_overrides(tmp_path):
    config = load(tmp_path, SPEC.replace("worlds: [bottom", "profile: paper\nworlds: [bottom")).runs[-1].config
    exploration = config.exploration
    assert (exploration.steps, exploration.seed, exploration.explorer) == (300, 7, "random_walk")
    assert exploration.fresh_samples == 100000
    assert config.simulation.world == "right"


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("seeds: [4, 7]", "", "seeds is missing"),
        ("seeds", "seds", "unknown key seds: did you mean seeds"),
        ("steps: 300", "stepps: 300", "run ergodic-bottom-seed4: .*unknown key exploration/stepps: did you mean"),
        ("[4, 7]", "[4, 4]", "two runs are named ergodic-bottom-seed4"),
        ("walk:", "Walk:", "name of a run is 'Walk-right-seed4'"),
    ],
)
def test_invalid_spec_is_refused(tmp_path, before, after, message):
    with pytest.raises((ConfigError, SessionError), match=message):
        load(tmp_path, SPEC.replace(before, after))


def test_spec_without_runs_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="no runs: give at least one world"):
        load(tmp_path, "worlds: []\nseeds: [1]\n")


def test_differences_name_changed_settings(tmp_path):
    stored = load(tmp_path, SPEC).runs[0].config
    changed = load(tmp_path, SPEC.replace("steps: 300", "steps: 400, samples: 500")).runs[0].config
    assert differences(stored, changed) == [
        "exploration/steps is 400 but was 300",
        "exploration/samples is 500 but was 1000",
    ]


def test_differences_ignore_settings_without_influence(tmp_path):
    stored = load(tmp_path, SPEC).runs[0].config
    changes = "steps: 300}, fingerprint: {bandwidth: 0.06}, identification: {candidates: 4}, arm: {retries: 1"
    assert differences(stored, load(tmp_path, SPEC.replace("steps: 300", changes)).runs[0].config) == []


def test_differences_include_clustering_if_stop_is_stable(tmp_path):
    text = SPEC.replace("steps: 300", "steps: 300, stop: stable")
    stored = load(tmp_path, text).runs[0].config
    changed = load(tmp_path, text.replace("stable", "stable}, fingerprint: {bandwidth: 0.06")).runs[0].config
    assert differences(stored, changed) == ["fingerprint/bandwidth is 0.06 but was 0.045"]


def test_differences_include_identification_if_active(tmp_path):
    text = SPEC.replace("steps: 300", "steps: 300, explorer: active")
    stored = load(tmp_path, text).runs[0].config
    changed = load(tmp_path, text.replace("active", "active}, identification: {margin: 0.03")).runs[0].config
    assert differences(stored, changed) == ["identification/margin is 0.03 but was 0.0225"]


def test_differences_ignore_what_depends_on_the_computer(tmp_path):
    run = load(tmp_path, SPEC).runs[0]
    sections = run.config.to_dict()
    sections["simulation"]["world"] = "/elsewhere/bottom.yaml"
    sections["training"].update(threads=7)
    sections["session"]["name"] = "x"
    other = type(run.config).from_dict(sections)
    assert differences(run.config, other) == []


def test_shipped_sweeps_are_valid():
    names = [load_sweep(path).name for path in sorted((ROOT / "experiments").glob("*.yaml"))]
    assert "learning_metrics" in names


def test_world_is_relative_to_file_of_sweep(tmp_path):
    (tmp_path / "worlds").mkdir()
    world = tmp_path / "worlds" / "my_world.yaml"
    world.write_text((ROOT / "worlds" / "right.yaml").read_text(encoding="utf-8"), encoding="utf-8")
    run = load(tmp_path, SPEC.replace("[bottom, right]", "[worlds/my_world.yaml]")).runs[0]
    assert run.name == "ergodic-my-world-seed4"
    assert run.config.simulation.world == str(world)


def test_unknown_world_is_an_error_that_names_the_run(tmp_path):
    with pytest.raises(WorldError, match=r"run ergodic-rigth-seed4: .*rigth"):
        check_worlds(load(tmp_path, SPEC.replace("[bottom, right]", "[bottom, rigth]")))
