"""From arguments to the configuration of one run."""

import pytest

from embodied_active_learning.errors import ConfigError, SessionError, WorldError
from embodied_active_learning.resolve import resolve
from embodied_active_learning.session.session import Session


def override(root, **values):
    given = {"session/root": root, "session/name": "run", **{key.replace("__", "/"): v for key, v in values.items()}}
    return [f"{key}={value}" for key, value in given.items()]


def test_a_profile_by_name_with_overrides(tmp_path):
    config = resolve("demo", override(tmp_path, exploration__seed=7, simulation__world="right"))
    assert (config.exploration.steps, config.exploration.seed) == (1000, 7)
    assert config.simulation.world.endswith("/worlds/right.yaml")


def test_an_override_without_a_value_keeps_what_the_profile_says(tmp_path):
    assert resolve("demo", override(tmp_path, exploration__steps="")).exploration.steps == 1000


def test_without_a_profile_the_run_is_the_papers(tmp_path):
    assert resolve("", override(tmp_path)).exploration.steps == 3000


def test_a_run_without_a_name_gets_one_that_is_legal_whatever_the_world_is_called(tmp_path):
    world = tmp_path / "My Table (2).yaml"
    world.write_text("objects: {}\n")
    config = resolve("demo", override(tmp_path, session__name="", simulation__world=world))
    assert config.session.name.startswith("my-table-2-ergodic-seed0-")


def test_a_resumed_session_keeps_its_own_configuration_but_for_what_is_said(tmp_path):
    made = resolve("demo", override(tmp_path, exploration__seed=3, exploration__explorer="uniform"))
    Session.open_for_writing(made).close()
    again = resolve("", override(tmp_path, session__resume="true", training__threads=1))
    assert again.exploration == made.exploration
    assert again.simulation == made.simulation
    assert again.training.threads == 1


def test_a_resumed_session_refuses_what_its_data_depends_on(tmp_path):
    Session.open_for_writing(resolve("demo", override(tmp_path))).close()
    with pytest.raises(SessionError, match="exploration/seed"):
        resolve("", override(tmp_path, session__resume="true", exploration__seed=5))


@pytest.mark.parametrize(
    ("overrides", "error", "expected"),
    [
        (["exploration.steps=5"], ConfigError, "not of the form section/key=value"),
        (["exploration/steps=["], ConfigError, "not plain YAML"),
        (["exploration/stepps=5"], ConfigError, "did you mean exploration/steps?"),
        (["simulation/world=rigth"], WorldError, "did you mean right?"),
        (["session/name=../x"], SessionError, "session/name"),
        (["session/resume=true"], SessionError, "no session"),
    ],
)
def test_what_cannot_run_is_refused_by_name(overrides, error, expected, tmp_path):
    with pytest.raises(error, match=expected.replace("?", r"\?")):
        resolve("demo", [*override(tmp_path), *overrides])
