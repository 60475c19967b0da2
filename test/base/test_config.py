"""The configuration: legal and illegal values, profiles, the update schedule, and the generated documentation."""

import sys
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from embodied_active_learning.config import Config, find_profile, load_profile, merge
from embodied_active_learning.errors import ConfigError
from embodied_active_learning.schema import settings

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools"))

import generate_docs  # noqa: E402  lies in tools/, which is no package


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"steps": 100}, "unknown section steps: did you mean exploration/steps?"),
        ({"exploraton": {}}, "unknown section exploraton: did you mean exploration?"),
        ({"exploration": {"steps": -1}}, "exploration/steps is -1: expected a whole number from 1 to 1e+06"),
        (
            {"exploration": {"explorer": "ergodyc"}},
            "expected one of ergodic, random_walk, uniform, uniform_ergodic, active; did you mean ergodic?",
        ),
        (
            {"workspace": {"x": [0.6, 0.3]}},
            "workspace/x is [0.6, 0.3]: expected a finite lower limit below the upper one",
        ),
        ({"camera": {"latency": 0.05}}, "camera/latency is 0.05 s, but the simulated camera has none"),
        ({"simulation": {"start": [0.0, 0.0, 0.0]}}, "simulation/start [0.0, 0.0, 0.0] is outside the workspace"),
        ({"exploration": {"step_duration": 0.01}}, "exploration/step_duration is 0.01 s, 2.4 physics steps"),
        ({"exploration": {"steps": 20}}, "exploration/steps is 20, fewer than training/first_update_at (64)"),
        ({"training": {"batch_size": 100}}, "training/batch_size is larger than training/first_update_at"),
        ({"model": {"channels": [10]}}, "model: channels, kernels and strides differ in length"),
        ({"model": {"kernels": [1, 3, 5]}}, "model: stride 2 is larger than kernel 1: the convolution skips pixels"),
    ],
)
def test_invalid_configuration_is_refused_with_key_and_range(values, expected):
    with pytest.raises(ConfigError) as refusal:
        Config.from_dict(values)
    assert expected in str(refusal.value)


def test_configuration_survives_yaml_round_trip():
    config = Config.from_dict({"exploration": {"steps": 70, "explorer": "uniform"}, "workspace": {"x": [0.3, 0.5]}})
    assert Config.from_dict(yaml.safe_load(yaml.safe_dump(config.to_dict()))) == config


def test_defaults_are_valid():
    assert Config.from_dict(Config().to_dict()) == Config()


@pytest.mark.parametrize("content", ["[1, 2]", "just words", b"\xff\xfe\x00"])
def test_profile_without_sections_is_refused(content, tmp_path):
    profile = tmp_path / "odd.yaml"
    profile.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ConfigError, match=r"odd\.yaml"):
        load_profile(profile)


def test_empty_profile_section_changes_nothing(tmp_path):
    profile = tmp_path / "empty.yaml"
    profile.write_text("exploration:\n")
    assert merge(load_profile(profile), {"exploration": {"seed": 3}}) == {"exploration": {"seed": 3}}


def test_unknown_profile_error_lists_similar_names():
    with pytest.raises(ConfigError, match=r"did you mean paper\?"):
        find_profile("papper", ROOT / "config")


def test_missing_profile_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"nowhere.yaml is missing"):
        load_profile(find_profile(str(tmp_path / "nowhere.yaml"), None))


@pytest.mark.parametrize("path", sorted((ROOT / "config").glob("*.yaml")), ids=lambda path: path.stem)
def test_shipped_profile_is_valid(path):
    Config.from_dict(load_profile(path))


def test_merge_does_not_modify_arguments():
    base, overrides = {"training": {"batch_size": 8}}, {"training": {"threads": 1}}
    assert merge(base, overrides) == {"training": {"batch_size": 8, "threads": 1}}
    assert base == {"training": {"batch_size": 8}}


@pytest.mark.parametrize(
    ("observations", "updates"),
    [(0, 0), (63, 0), (64, 3), (65, 6), (1063, 3000), (2999, 8808), (3000, 9000), (3001, 9000)],
)
def test_three_updates_are_due_per_observation_from_the_64th(observations, updates):
    assert Config().update_plan.due(observations) == updates


@given(
    steps=st.integers(120, 300),
    first=st.integers(8, 120),
    ratio=st.integers(0, 5),
    observations=st.integers(0, 320),
)
def test_update_is_due_once_its_observations_are_stored(steps, first, ratio, observations):
    training = {"batch_size": 8, "first_update_at": first, "updates_per_observation": ratio}
    config = Config.from_dict({"exploration": {"steps": steps}, "training": training})
    due = sum(
        config.update_plan.observations_needed(update) <= observations for update in range(config.update_plan.total)
    )
    assert config.update_plan.due(observations) == due


@given(observations=st.integers(1, 2999))
def test_planner_awaits_updates_of_previous_observations(observations):
    config = Config()
    assert config.update_plan.awaited(observations) == config.update_plan.due(observations - 1)
    assert config.update_plan.awaited(3000) == 9000


def test_every_setting_has_a_meaning():
    assert all(item.metadata["meaning"] for _, item in settings(Config))


def test_generated_files_are_up_to_date():
    for path, text in generate_docs.generated_files().items():
        assert path.read_text(encoding="utf-8") == text, f"{path} is outdated: run make docs"


def test_paper_profile_differs_from_the_defaults():
    """Each value of a profile of differences is a difference, and the paper's are those that the paper states."""
    for name in ("paper", "demo"):
        default = Config().to_dict()
        values = load_profile(ROOT / "config" / f"{name}.yaml")
        assert [key for section, keys in values.items() for key in keys if default[section][key] == keys[key]] == []
    config = Config.from_dict(load_profile(ROOT / "config" / "paper.yaml"))
    assert (config.planner.random_candidates, config.planner.normalise_kernels) == (0, False)
    assert (config.fingerprint.clustering, config.identification.evidence) == ("camera", "counted")
    assert config.objective.beta_max > 16.0, "beta reaches about 16 without a limit"


def test_default_profile_is_the_default_configuration():
    assert Config.from_dict(load_profile(ROOT / "config" / "default.yaml")) == Config()


@given(st.integers(2, 5), st.integers(1, 40), st.integers(1, 4), st.integers(20, 300), st.data())
def test_rounds_of_several_trainers_are_due_as_a_whole(trainers, updates, ratio, steps, data):
    training = {"trainers": trainers, "updates_per_round": updates, "updates_per_observation": ratio}
    training.update(batch_size=8, first_update_at=8)
    config = Config.from_dict({"training": training, "exploration": {"steps": steps}})
    count = data.draw(st.integers(0, steps - 1))
    due, awaited = config.update_plan.due(count), config.update_plan.awaited(count)
    assert due % (trainers * updates) == 0
    assert awaited == max(0, due - trainers * updates)
    assert due == 0 or config.update_plan.observations_needed(due - 1) <= count
    assert config.update_plan.awaited(steps) == config.update_plan.due(steps) == ratio * steps


@given(st.integers(1, 4), st.integers(1, 9), st.integers(1, 4), st.integers(20, 200), st.data())
def test_model_is_awaited_from_the_computed_observation_on(trainers, updates, ratio, steps, data):
    training = {"trainers": trainers, "updates_per_round": updates, "updates_per_observation": ratio}
    training.update(batch_size=8, first_update_at=8)
    plan = Config.from_dict({"training": training, "exploration": {"steps": steps}}).update_plan
    wanted = plan.per_refresh * data.draw(st.integers(1, 50))
    count = plan.observations_awaiting(wanted)
    assert plan.awaited(count - 1) < wanted
    assert plan.awaited(count) >= min(wanted, plan.total)
