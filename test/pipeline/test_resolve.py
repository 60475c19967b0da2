"""From arguments to the configuration of one run."""

import pytest

from embodied_active_learning.errors import ConfigError, SessionError, WorldError
from embodied_active_learning.pipeline.resolve import resolve_config
from embodied_active_learning.ros.launch_arguments import parse_overrides
from embodied_active_learning.session.session import Session


def override(root, **values):
    given = {"session/root": root, "session/name": "run", **{key.replace("__", "/"): v for key, v in values.items()}}
    return [f"{key}={value}" for key, value in given.items()]


def resolve(profile, overrides, robot_profile="", needs_arm=True):
    return resolve_config(profile, parse_overrides(overrides), robot_profile, needs_arm=needs_arm)


def test_profile_with_overrides(tmp_path):
    config = resolve("demo", override(tmp_path, exploration__seed=7, simulation__world="right"))
    assert (config.exploration.steps, config.exploration.seed) == (1000, 7)
    assert config.simulation.world.endswith("/worlds/right.yaml")


def test_missing_profile_gives_defaults(tmp_path):
    assert resolve("", override(tmp_path)).exploration.steps == 3000


def test_related_overrides_are_checked_together(tmp_path):
    """The duration is shorter than the default of step_duration, which is overridden too."""
    config = resolve("demo", override(tmp_path, arm__max_duration=0.15, exploration__step_duration=0.1))
    assert (config.arm.max_duration, config.exploration.step_duration) == (0.15, 0.1)
    with pytest.raises(ConfigError, match="step_duration is longer than arm/max_duration"):
        resolve("demo", override(tmp_path, arm__max_duration=0.15))


def test_default_session_name_is_valid(tmp_path):
    world = tmp_path / "My Table (2).yaml"
    world.write_text("objects: {}\n")
    config = resolve("demo", override(tmp_path, session__name="", simulation__world=world))
    assert config.session.name.startswith("my-table-2-ergodic-seed0-")


def test_default_session_name_has_class_of_own_explorer(tmp_path):
    config = resolve("demo", override(tmp_path, session__name="", exploration__explorer="mine.spiral:SpiralExplorer"))
    assert config.session.name.startswith("diagonal-spiralexplorer-seed0-")


def test_resumed_session_keeps_its_config(tmp_path):
    made = resolve("demo", override(tmp_path, exploration__seed=3, exploration__explorer="uniform"))
    Session.open_for_writing(made).close()
    again = resolve("", override(tmp_path, session__resume="true", training__threads=1))
    assert again.exploration == made.exploration
    assert again.simulation == made.simulation
    assert again.training.threads == 1


def test_session_without_world_is_readable_only(tmp_path):
    world = tmp_path / "mine.yaml"
    world.write_text("objects: {}\n")
    Session.open_for_writing(resolve("demo", override(tmp_path, simulation__world=world))).close()
    world.unlink()
    again = override(tmp_path, session__resume="true")
    assert resolve("", again, needs_arm=False).exploration.steps == 1000
    with pytest.raises(WorldError, match=r"mine.yaml is missing"):
        resolve("", again)


def test_resume_rejects_incompatible_override(tmp_path):
    Session.open_for_writing(resolve("demo", override(tmp_path))).close()
    with pytest.raises(SessionError, match="exploration/seed"):
        resolve("", override(tmp_path, session__resume="true", exploration__seed=5))


def test_resume_without_a_name_lists_the_sessions(tmp_path):
    Session.open_for_writing(resolve("demo", override(tmp_path))).close()
    with pytest.raises(SessionError, match=r"resume:=true needs session:=NAME; known are run$"):
        resolve("", override(tmp_path, session__name="", session__resume="true"))


def test_robot_profile_overrides_run_profile(tmp_path):
    profile = tmp_path / "fast.yaml"
    profile.write_text("arm: {max_speed: 0.3}\nexploration: {steps: 200}\n")
    config = resolve(str(profile), override(tmp_path, arm__robot="franka"))
    assert config.exploration.steps == 200
    assert config.arm.max_speed == resolve("", override(tmp_path, arm__robot="franka")).arm.max_speed < 0.3


def test_own_robot_profile_is_used(tmp_path):
    lab = tmp_path / "lab.yaml"
    lab.write_text("franka: {table_height: 0.12}\n")
    config = resolve("demo", override(tmp_path, arm__robot="franka"), str(lab))
    assert config.franka.table_height == 0.12


def test_session_of_real_robot_is_named_after_it(tmp_path):
    config = resolve("demo", override(tmp_path, arm__robot="franka", session__name=""))
    assert config.session.name.startswith("franka-ergodic-seed0-")


def test_world_for_real_robot_is_rejected(tmp_path):
    with pytest.raises(ConfigError, match="only a simulated world can be chosen"):
        resolve("demo", override(tmp_path, arm__robot="franka", simulation__world="right"))


def test_robot_profile_in_simulation_is_rejected(tmp_path):
    with pytest.raises(ConfigError, match="is for a real robot"):
        resolve("demo", override(tmp_path), "franka")


def test_velocity_service_uses_the_real_robot_profile(tmp_path):
    config = resolve("demo", override(tmp_path, arm__robot="velocity_service"))
    assert config.arm.max_turn_rate == resolve("demo", override(tmp_path, arm__robot="franka")).arm.max_turn_rate


def test_resumed_session_keeps_robot_settings(tmp_path):
    lab = tmp_path / "lab.yaml"
    lab.write_text("franka: {table_height: 0.12}\n")
    Session.open_for_writing(resolve("demo", override(tmp_path, arm__robot="franka"), str(lab))).close()
    again = resolve("", override(tmp_path, session__resume="true", arm__robot="franka"))
    assert again.franka.table_height == 0.12
    with pytest.raises(SessionError, match="arm/robot is 'pybullet' but the session has 'franka'"):
        resolve("", override(tmp_path, session__resume="true", arm__robot="pybullet"))
    lab.write_text("franka: {table_height: 0.2}\n")
    with pytest.raises(SessionError, match="franka/table_height"):
        resolve("", override(tmp_path, session__resume="true", arm__robot="franka"), str(lab))


def test_arm_cannot_resume_recorded_session(tmp_path):
    Session.open_for_writing(resolve("demo", override(tmp_path, arm__robot="recording"))).close()
    for robot in ("pybullet", "franka"):
        with pytest.raises(SessionError, match=r"learned from a recording.* views_from:=stored"):
            resolve("", override(tmp_path, session__resume="true", arm__robot=robot))


@pytest.mark.parametrize(
    ("overrides", "error", "expected"),
    [
        (["exploration/stepps=5"], ConfigError, "did you mean exploration/steps?"),
        (["simulation/world=rigth"], WorldError, "did you mean right?"),
        (["session/name=../x"], SessionError, "session/name"),
        (["session/resume=true"], SessionError, "no session"),
    ],
)
def test_invalid_run_is_rejected(overrides, error, expected, tmp_path):
    with pytest.raises(error, match=expected.replace("?", r"\?")):
        resolve("demo", [*override(tmp_path), *overrides])
