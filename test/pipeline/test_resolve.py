"""From arguments to the configuration of one run."""

import pytest

from embodied_active_learning.errors import ConfigError, SessionError, WorldError
from embodied_active_learning.pipeline.resolve import check_bringup, resolve
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


def test_a_session_from_another_computer_is_looked_at_without_its_world_but_not_explored_further(tmp_path):
    world = tmp_path / "mine.yaml"
    world.write_text("objects: {}\n")
    Session.open_for_writing(resolve("demo", override(tmp_path, simulation__world=world))).close()
    world.unlink()
    again = override(tmp_path, session__resume="true")
    assert resolve("", again, needs_arm=False).exploration.steps == 1000
    with pytest.raises(WorldError, match=r"mine.yaml is missing"):
        resolve("", again)


def test_a_resumed_session_refuses_what_its_data_depends_on(tmp_path):
    Session.open_for_writing(resolve("demo", override(tmp_path))).close()
    with pytest.raises(SessionError, match="exploration/seed"):
        resolve("", override(tmp_path, session__resume="true", exploration__seed=5))


def test_a_real_robot_has_its_own_limits_whatever_the_runs_profile_says(tmp_path):
    profile = tmp_path / "fast.yaml"
    profile.write_text("arm: {max_speed: 0.3}\nexploration: {steps: 200}\n")
    config = resolve(str(profile), override(tmp_path, arm__robot="franka"))
    assert config.exploration.steps == 200
    assert config.arm.max_speed == resolve("", override(tmp_path, arm__robot="franka")).arm.max_speed < 0.3


def test_a_lab_gives_its_own_values_of_the_robot(tmp_path):
    lab = tmp_path / "lab.yaml"
    lab.write_text("franka: {table_height: 0.12}\n")
    config = resolve("demo", override(tmp_path, arm__robot="franka"), str(lab))
    assert config.franka.table_height == 0.12


def test_a_run_on_a_real_robot_is_named_after_it_and_not_after_a_simulated_world(tmp_path):
    config = resolve("demo", override(tmp_path, arm__robot="franka", session__name=""))
    assert config.session.name.startswith("franka-ergodic-seed0-")


def test_a_world_cannot_be_chosen_for_a_real_robot(tmp_path):
    with pytest.raises(ConfigError, match="only a simulated world can be chosen"):
        resolve("demo", override(tmp_path, arm__robot="franka", simulation__world="right"))


def test_a_profile_of_a_robot_is_refused_in_simulation(tmp_path):
    with pytest.raises(ConfigError, match="is for a real robot"):
        resolve("demo", override(tmp_path), "franka")


@pytest.mark.parametrize(
    ("robot", "bringup", "robot_ip", "expected"),
    [
        ("franka", "all", "", "robot_ip is missing"),
        ("franka", "some", "172.16.0.2", "expected one of all, nodes, none"),
        ("recording", "all", "", "use bringup:=none"),
    ],
)
def test_an_arm_that_cannot_be_started_is_refused(tmp_path, robot, bringup, robot_ip, expected):
    config = resolve("demo", override(tmp_path, arm__robot=robot))
    with pytest.raises(ConfigError, match=expected):
        check_bringup(config, bringup, robot_ip)


@pytest.mark.parametrize(("robot", "bringup"), [("pybullet", "all"), ("franka", "nodes"), ("recording", "none")])
def test_an_arm_needs_no_address_where_nothing_is_to_be_connected_to_it(tmp_path, robot, bringup):
    check_bringup(resolve("demo", override(tmp_path, arm__robot=robot)), bringup, "")


def test_a_resumed_session_keeps_its_robot_and_what_was_measured_of_it(tmp_path):
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


def test_no_arm_goes_on_with_what_was_learned_from_a_recording(tmp_path):
    Session.open_for_writing(resolve("demo", override(tmp_path, arm__robot="recording"))).close()
    for robot in ("pybullet", "franka"):
        with pytest.raises(SessionError, match=r"learned from a recording.* views_from:=stored"):
            resolve("", override(tmp_path, session__resume="true", arm__robot=robot))


@pytest.mark.parametrize(
    ("overrides", "error", "expected"),
    [
        (["exploration.steps=5"], ConfigError, "malformed: expected section/key=value"),
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
