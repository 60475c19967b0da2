"""Explorers in closed loop with an arm that executes commands exactly, and their registry."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ConfigError, ObservationError
from embodied_active_learning.exploration.baselines import RandomWalkExplorer
from embodied_active_learning.exploration.commands import PoseCommand, VelocityCommand
from embodied_active_learning.exploration.controller import ErgodicController
from embodied_active_learning.exploration.explorer import Explorer
from embodied_active_learning.exploration.samples import WorkspaceSamples
from embodied_active_learning.registry import EXPLORERS

CONFIG = Config()
SMALL = dataclasses.replace(
    CONFIG, exploration=dataclasses.replace(CONFIG.exploration, samples=100, fresh_samples=10, kernel_variance=0.0576)
)
WORKSPACE = CONFIG.workspace.box()
STATE = arrays(np.float64, (3,), elements=st.floats(-1, 1))
FLAT = np.full(100, 0.01)


def obey(position, command):
    """Return the normalised state (3,) after an exactly executed command."""
    if isinstance(command, PoseCommand):
        return WORKSPACE.normalise([command.x, command.y, command.theta])
    return WORKSPACE.normalise(WORKSPACE.denormalise(position) + command.velocity * command.duration)


def explore(name, position, steps, seed=0, target=FLAT, measured_velocity=None):
    explorer, samples = EXPLORERS[name](SMALL, seed), WorkspaceSamples(SMALL)
    samples.visit(position)
    for _ in range(steps):
        explorer.observe(position, measured_velocity)
        samples.refresh()
        command = explorer.next_command(target, samples)
        position = obey(position, command)
        samples.visit(position)
    return samples.visited


@pytest.mark.parametrize("name", EXPLORERS)
def test_registered_explorer_is_configurable(name):
    config = Config.from_dict({"exploration": {"explorer": name}})
    assert isinstance(EXPLORERS[config.exploration.explorer](config, 0), Explorer)


def test_unknown_explorer_error_lists_names():
    with pytest.raises(
        ConfigError, match="'levy_flight': known are ergodic, random_walk, uniform, uniform_ergodic, active"
    ):
        EXPLORERS["levy_flight"]
    with pytest.raises(ConfigError, match="random_walk"):
        Config.from_dict({"exploration": {"explorer": "levy_flight"}})


def test_own_explorer_needs_one_registration():
    EXPLORERS.register("levy_flight")(RandomWalkExplorer)
    try:
        config = Config.from_dict({"exploration": {"explorer": "levy_flight"}})
        assert isinstance(EXPLORERS[config.exploration.explorer](config, 0), RandomWalkExplorer)
        with pytest.raises(ConfigError, match="already registered"):
            EXPLORERS.register("levy_flight")(RandomWalkExplorer)
    finally:
        EXPLORERS.unregister("levy_flight")


def test_explorer_of_another_module_is_imported():
    name = f"{RandomWalkExplorer.__module__}:RandomWalkExplorer"
    config = Config.from_dict({"exploration": {"explorer": name}})
    assert isinstance(EXPLORERS[config.exploration.explorer](config, 0), RandomWalkExplorer)


@pytest.mark.parametrize(
    ("name", "remedy"),
    [("no_such_module:Explorer", "check PYTHONPATH"), (f"{RandomWalkExplorer.__module__}:NoSuch", "correct its name")],
)
def test_explorer_that_cannot_be_imported_is_refused(name, remedy):
    with pytest.raises(ConfigError, match=f"explorer '{name}' cannot be imported: .*{remedy}"):
        EXPLORERS[name]


def test_mistake_in_module_of_explorer_keeps_its_traceback(tmp_path, monkeypatch):
    (tmp_path / "test_failing_module.py").write_text("import math\nmath.squareroot\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(AttributeError) as raised:
        EXPLORERS["test_failing_module:Explorer"]
    assert "test_failing_module.py:2" in str(raised.getrepr(style="short"))


@pytest.mark.parametrize("name", ["os.system", "module:a b", ":Explorer", "module:", "a:b:c", "../module:Explorer"])
def test_malformed_reference_to_an_explorer_is_refused(name):
    with pytest.raises(ConfigError, match="explorer"):
        Config.from_dict({"exploration": {"explorer": name}})


@pytest.mark.parametrize("name", EXPLORERS)
@settings(max_examples=8)
@given(STATE, arrays(np.float64, (100,), elements=st.floats(0, 1)), st.integers(0, 2**31 - 1))
def test_commands_stay_in_workspace(name, position, target, seed):
    visited = explore(name, position, 20, seed, target)
    assert np.all(np.abs(visited) <= 1.0 + 1e-12)


@settings(max_examples=20)
@given(STATE, arrays(np.float64, (3,), elements=st.floats(-5, 5)), arrays(np.float64, (100,), elements=st.floats(0, 1)))
def test_plan_stays_in_workspace_for_any_measured_velocity(position, velocity, target):
    controller, samples = ErgodicController(SMALL, 0), WorkspaceSamples(SMALL, [position])
    for _ in range(3):
        controller.observe(position, velocity)
        position = obey(position, controller.next_command(target, samples))
        assert np.all(np.abs(controller.planned_states) <= 1.0)
        assert np.all(np.abs(position) <= 1.0 + 1e-12)


@pytest.mark.parametrize("name", ["ergodic", "random_walk"])
@given(position=arrays(np.float64, (3,), elements=st.floats(-1.5, 1.5)))
@settings(max_examples=10)
def test_first_command_from_outside_leads_back(name, position):
    after = explore(name, position, 1)[-1]
    outside = np.abs(position) > 1.0
    assert np.all(np.abs(after[outside]) < np.abs(position[outside]))
    assert np.all(np.abs(after[~outside]) <= 1.0 + 1e-12)


@pytest.mark.parametrize("name", EXPLORERS)
def test_commands_respect_arm_limits(name):
    explorer, samples = EXPLORERS[name](SMALL, 1), WorkspaceSamples(SMALL)
    for _ in range(30):
        command = explorer.next_command(FLAT, samples)
        if isinstance(command, VelocityCommand):
            assert np.all(np.abs(command.velocity) <= [0.15, 0.15, 1.5])
            assert command.duration == 0.2
        else:
            assert WORKSPACE.contains([command.x, command.y, command.theta])


@pytest.mark.parametrize("name", EXPLORERS)
def test_path_depends_on_seed_only(name):
    paths = [explore(name, np.zeros(3), 12, seed) for seed in (1, 1, 2)]
    np.testing.assert_array_equal(paths[0], paths[1])
    if name in ("random_walk", "uniform"):
        assert not np.allclose(paths[0], paths[2])


def test_command_reaches_planned_state():
    controller, samples = ErgodicController(SMALL, 0), WorkspaceSamples(SMALL)
    position = np.array([0.2, -0.9, 0.4])
    for _ in range(15):
        controller.observe(position)
        position = obey(position, controller.next_command(FLAT, samples))
        np.testing.assert_allclose(position, controller.planned_states[0], atol=1e-12)
        samples.visit(position)


def test_uniform_ergodic_explorer_ignores_target():
    bump = np.where(np.arange(100) == 3, 1.0, 1e-3)
    flat_path = explore("ergodic", np.zeros(3), 12, target=FLAT)
    np.testing.assert_array_equal(explore("uniform_ergodic", np.zeros(3), 12, target=bump), flat_path)
    assert not np.allclose(explore("ergodic", np.zeros(3), 12, target=bump), flat_path)


def first_plan(observe):
    """Return the second plan of a controller after observe(controller, planned position, commanded SI velocity)."""
    controller, samples = ErgodicController(SMALL, 0), WorkspaceSamples(SMALL, np.zeros((5, 3)))
    command = controller.next_command(FLAT, samples)
    observe(controller, controller.planned_states[0].copy(), command.velocity)
    return controller.plan(FLAT, samples)


def test_measured_velocity_as_commanded_leaves_plan_unchanged():
    blind = first_plan(lambda controller, position, _: controller.observe(position))
    seeing = first_plan(lambda controller, position, velocity: controller.observe(position, velocity))
    np.testing.assert_allclose(seeing.positions, blind.positions)


def test_plan_adopts_half_of_velocity_tracking_error():
    error = np.array([0.012, 0.0, -0.24])  # m/s, rad/s: 0.1 and -0.1 velocity units
    blind = first_plan(lambda controller, position, _: controller.observe(position))
    seeing = first_plan(lambda controller, position, velocity: controller.observe(position, velocity + error))
    start = [plan.velocities[0] - 0.2 * plan.controls[0] for plan in (seeing, blind)]
    np.testing.assert_allclose(start[0] - start[1], [0.05, 0.0, -0.05], atol=1e-12)


def test_second_observation_does_not_shift_plan_again():
    once = first_plan(lambda controller, position, velocity: controller.observe(position, velocity))

    def twice(controller, position, velocity):
        controller.observe(position + 0.1, 0.5 * velocity)
        controller.observe(position, velocity)

    np.testing.assert_array_equal(first_plan(twice).positions, once.positions)


def test_plan_after_reset_starts_at_rest():
    def stop(controller, position, _):
        controller.reset()
        controller.observe(position)

    plan = first_plan(stop)
    np.testing.assert_allclose(plan.velocities[0], 0.2 * plan.controls[0])


@pytest.mark.parametrize(("position", "velocity"), [([np.nan, 0, 0], None), ([0, 0, 0], [np.inf, 0, 0])])
def test_non_finite_observation_rejected(position, velocity):
    with pytest.raises(ObservationError, match="not finite"):
        ErgodicController(SMALL, 0).observe(np.array(position), velocity)


@pytest.mark.parametrize("name", EXPLORERS)
def test_planned_states_shape_before_and_after_command(name):
    explorer = EXPLORERS[name](SMALL, 0)
    assert explorer.planned_states.shape == (0, 3)
    explorer.next_command(FLAT, WorkspaceSamples(SMALL))
    assert explorer.planned_states.shape == ((10, 3) if "ergodic" in name or name == "active" else (0, 3))
