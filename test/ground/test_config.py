"""The configuration: what it accepts, what it refuses and how, and that what derives from it is up to date."""

import sys
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from embodied_active_learning.config import Config, find_profile, load_profile, merge, settings
from embodied_active_learning.errors import ConfigError

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools"))

import generate_docs  # noqa: E402  lies in tools/, which is no package


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"exploraton": {}}, "unknown section exploraton: did you mean exploration?"),
        ({"exploration": {"step": 5}}, "unknown key exploration/step: did you mean exploration/steps?"),
        ({"exploration": {"steps": "many"}}, "exploration/steps is 'many': give a whole number"),
        ({"exploration": {"steps": 2.5}}, "exploration/steps is 2.5: give a whole number"),
        ({"exploration": {"steps": float("nan")}}, "exploration/steps is nan: give a whole number"),
        ({"exploration": {"steps": True}}, "exploration/steps is True: give a whole number"),
        ({"exploration": {"steps": -1}}, "exploration/steps is -1: legal is 1 to"),
        ({"exploration": {"explorer": "ergodyc"}}, "did you mean ergodic? legal are ergodic, random_walk"),
        ({"workspace": {"x": [0.6, 0.3]}}, "workspace/x is [0.6, 0.3]: give a finite lower limit below the upper one"),
        ({"workspace": {"x": [0.1, 0.2, 0.3]}}, "workspace/x has 3 numbers"),
        ({"workspace": {"x": 0.3}}, "workspace/x is 0.3: give a list of numbers"),
        ({"planner": {"horizon": 0}}, "planner/horizon is 0: legal is 2 to 200"),
        ({"planner": {"velocity_limits": [1.0]}}, "planner/velocity_limits needs 3 numbers"),
        ({"planner": {"normalise_kernels": 1}}, "planner/normalise_kernels is 1: give true or false"),
        ({"simulation": {"start": [0.0, 0.0, 0.0]}}, "simulation/start [0.0, 0.0, 0.0] lies outside the workspace"),
        ({"exploration": {"steps": 20}}, "exploration/steps is 20, fewer than training/first_update_at (64)"),
        ({"training": {"batch_size": 100}}, "training/batch_size is larger than training/first_update_at"),
        ({"training": None}, "section training is None: give keys and values"),
        ({"model": {"channels": [10]}}, "model/channels, model/kernels and model/strides differ in length"),
        (["training"], "the configuration is list, not sections of keys"),
    ],
)
def test_a_configuration_that_cannot_work_is_refused_with_the_key_and_the_remedy(values, expected):
    with pytest.raises(ConfigError) as refusal:
        Config.from_dict(values)
    assert expected in str(refusal.value)


def test_a_configuration_survives_the_way_through_yaml():
    config = Config.from_dict({"exploration": {"steps": 70, "explorer": "uniform"}, "workspace": {"x": [0.3, 0.5]}})
    assert Config.from_dict(yaml.safe_load(yaml.safe_dump(config.to_dict()))) == config


def test_the_defaults_are_legal_by_their_own_rules():
    assert Config.from_dict(Config().to_dict()) == Config()


def test_a_profile_with_python_objects_in_it_is_refused_and_runs_nothing(tmp_path):
    canary = tmp_path / "canary"
    profile = tmp_path / "evil.yaml"
    profile.write_text(f"exploration: !!python/object/apply:os.system ['touch {canary}']\n")
    with pytest.raises(ConfigError, match="is not plain YAML"):
        load_profile(profile)
    assert not canary.exists()


@pytest.mark.parametrize("content", ["[1, 2]", "just words", b"\xff\xfe\x00"])
def test_a_profile_that_is_no_sections_of_keys_is_refused(content, tmp_path):
    profile = tmp_path / "odd.yaml"
    profile.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ConfigError, match=r"odd\.yaml"):
        load_profile(profile)


def test_an_empty_section_of_a_profile_changes_nothing(tmp_path):
    profile = tmp_path / "empty.yaml"
    profile.write_text("exploration:\n")
    assert merge(load_profile(profile), {"exploration": {"seed": 3}}) == {"exploration": {"seed": 3}}


def test_an_unknown_profile_is_answered_with_those_there_are():
    with pytest.raises(ConfigError, match="there are authors_hardware, authors_simulation, demo, franka, paper"):
        find_profile("papper", ROOT / "config")


def test_a_missing_profile_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"nowhere.yaml is missing"):
        load_profile(find_profile(str(tmp_path / "nowhere.yaml"), None))


@pytest.mark.parametrize("path", sorted((ROOT / "config").glob("*.yaml")), ids=lambda path: path.stem)
def test_every_shipped_profile_is_a_legal_configuration(path):
    Config.from_dict(load_profile(path))


def test_merging_keeps_its_arguments_as_they_are():
    base, overrides = {"training": {"batch_size": 8}}, {"training": {"threads": 1}}
    assert merge(base, overrides) == {"training": {"batch_size": 8, "threads": 1}}
    assert base == {"training": {"batch_size": 8}}


@pytest.mark.parametrize(
    ("observations", "updates"),
    [(0, 0), (63, 0), (64, 3), (65, 6), (1063, 3000), (2999, 8808), (3000, 9000), (3001, 9000)],
)
def test_three_updates_are_due_for_each_observation_from_the_64th_and_9000_at_the_end(observations, updates):
    assert Config().updates_due(observations) == updates


@given(
    steps=st.integers(120, 300),
    first=st.integers(8, 120),
    ratio=st.integers(0, 5),
    observations=st.integers(0, 320),
)
def test_an_update_is_due_as_soon_as_there_are_the_observations_that_it_needs(steps, first, ratio, observations):
    training = {"batch_size": 8, "first_update_at": first, "updates_per_observation": ratio}
    config = Config.from_dict({"exploration": {"steps": steps}, "training": training})
    due = sum(config.observations_needed(update) <= observations for update in range(config.updates_planned))
    assert config.updates_due(observations) == due


@given(observations=st.integers(1, 2999))
def test_the_planner_waits_for_what_the_observations_before_the_newest_call_for(observations):
    config = Config()
    assert config.updates_awaited(observations) == config.updates_due(observations - 1)
    assert config.updates_awaited(3000) == 9000


def test_every_setting_says_what_it_means():
    assert all(item.metadata["meaning"] for _, item in settings())


def test_the_paper_profile_and_the_readme_list_every_setting_as_it_is():
    assert (ROOT / "config" / "paper.yaml").read_text() == generate_docs.profile_text()
    readme = (ROOT / "README.md").read_text()
    assert generate_docs.with_table(readme) == readme, "run: make docs"
