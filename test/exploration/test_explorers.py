"""Each explorer in a closed loop with an arm that does exactly what it is told."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ConfigError, ObservationError
from embodied_active_learning.exploration.baselines import UniformExplorer
from embodied_active_learning.exploration.commands import PoseCommand, VelocityCommand
from embodied_active_learning.exploration.controller import ErgodicController
from embodied_active_learning.exploration.explorer import Explorer
from embodied_active_learning.exploration.explorers import make_explorer
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
    """Where a command leads an arm that follows it exactly. (3,) normalised -> (3,) normalised."""
    if isinstance(command, PoseCommand):
        return WORKSPACE.normalise([command.x, command.y, command.theta])
    return WORKSPACE.normalise(WORKSPACE.denormalise(position) + command.velocity * command.duration)


def explore(name, position, steps, seed=0, target=FLAT, measured_velocity=None):
    explorer, samples = make_explorer(name, SMALL, seed), WorkspaceSamples(SMALL)
    samples.visit(position)
    for _ in range(steps):
        explorer.observe(position, measured_velocity)
        samples.refresh()
        command = explorer.next_command(target, samples)
        position = obey(position, command)
        samples.visit(position)
    return samples.visited


def test_every_registered_explorer_exists():
    assert all(issubclass(EXPLORERS[name], Explorer) for name in EXPLORERS)


def test_registered_explorer_can_be_configured():
    EXPLORERS.register("mine")(UniformExplorer)
    try:
        config = Config.from_dict({"exploration": {"explorer": "mine"}})
        assert isinstance(make_explorer(config.exploration.explorer, config, 0), UniformExplorer)
        with pytest.raises(ConfigError, match="already registered"):
            EXPLORERS.register("mine")(UniformExplorer)
    finally:
        EXPLORERS.unregister("mine")


def test_an_unknown_explorer_is_refused_with_the_names_there_are():
    with pytest.raises(ConfigError, match="'levy_flight': known are ergodic, random_walk, uniform, uniform_ergodic"):
        make_explorer("levy_flight", CONFIG, 0)


@pytest.mark.parametrize("name", EXPLORERS)
@settings(max_examples=8, deadline=None)
@given(STATE, arrays(np.float64, (100,), elements=st.floats(0, 1)), st.integers(0, 2**31 - 1))
def test_no_command_leads_out_of_the_workspace(name, position, target, seed):
    visited = explore(name, position, 20, seed, target)
    assert np.all(np.abs(visited) <= 1.0 + 1e-12)


@settings(max_examples=20, deadline=None)
@given(STATE, arrays(np.float64, (3,), elements=st.floats(-5, 5)), arrays(np.float64, (100,), elements=st.floats(0, 1)))
def test_no_measured_velocity_makes_the_plan_leave_the_workspace(position, velocity, target):
    controller, samples = ErgodicController(SMALL, 0), WorkspaceSamples(SMALL, [position])
    for _ in range(3):
        controller.observe(position, velocity)
        position = obey(position, controller.next_command(target, samples))
        assert np.all(np.abs(controller.planned_states) <= 1.0)
        assert np.all(np.abs(position) <= 1.0 + 1e-12)


@pytest.mark.parametrize("name", ["ergodic", "random_walk"])
@given(position=arrays(np.float64, (3,), elements=st.floats(-1.5, 1.5)))
@settings(max_examples=10, deadline=None)
def test_from_outside_the_first_command_leads_back(name, position):
    after = explore(name, position, 1)[-1]
    outside = np.abs(position) > 1.0
    assert np.all(np.abs(after[outside]) < np.abs(position[outside]))
    assert np.all(np.abs(after[~outside]) <= 1.0 + 1e-12)


@pytest.mark.parametrize("name", EXPLORERS)
def test_commands_keep_the_limits_of_the_arm(name):
    explorer, samples = make_explorer(name, SMALL, 1), WorkspaceSamples(SMALL)
    for _ in range(30):
        command = explorer.next_command(FLAT, samples)
        if isinstance(command, VelocityCommand):
            assert np.all(np.abs(command.velocity) <= [0.15, 0.15, 1.5])
            assert command.duration == 0.2
        else:
            assert WORKSPACE.contains([command.x, command.y, command.theta])


@pytest.mark.parametrize("name", EXPLORERS)
def test_one_seed_gives_one_path_and_another_seed_another(name):
    paths = [explore(name, np.zeros(3), 12, seed) for seed in (1, 1, 2)]
    np.testing.assert_array_equal(paths[0], paths[1])
    if name in ("random_walk", "uniform"):
        assert not np.allclose(paths[0], paths[2])


def test_the_command_ends_the_step_where_the_plan_does():
    controller, samples = ErgodicController(SMALL, 0), WorkspaceSamples(SMALL)
    position = np.array([0.2, -0.9, 0.4])
    for _ in range(15):
        controller.observe(position)
        position = obey(position, controller.next_command(FLAT, samples))
        np.testing.assert_allclose(position, controller.planned_states[0], atol=1e-12)
        samples.visit(position)


def test_the_uniform_ergodic_explorer_takes_no_notice_of_the_target():
    bump = np.where(np.arange(100) == 3, 1.0, 1e-3)
    flat_path = explore("ergodic", np.zeros(3), 12, target=FLAT)
    np.testing.assert_array_equal(explore("uniform_ergodic", np.zeros(3), 12, target=bump), flat_path)
    assert not np.allclose(explore("ergodic", np.zeros(3), 12, target=bump), flat_path)


def first_plan(observe):
    """The controller after one command, re-anchored by observe(controller, where it should be, SI velocity)."""
    controller, samples = ErgodicController(SMALL, 0), WorkspaceSamples(SMALL, np.zeros((5, 3)))
    command = controller.next_command(FLAT, samples)
    observe(controller, controller.planned_states[0].copy(), command.velocity)
    return controller.plan(FLAT, samples)


def test_a_velocity_measured_as_commanded_changes_nothing():
    blind = first_plan(lambda controller, position, _: controller.observe(position))
    seeing = first_plan(lambda controller, position, velocity: controller.observe(position, velocity))
    np.testing.assert_allclose(seeing.positions, blind.positions)


def test_half_of_the_velocity_tracking_error_is_taken_over():
    error = np.array([0.012, 0.0, -0.24])  # m/s, rad/s: 0.1 and -0.1 velocity units
    blind = first_plan(lambda controller, position, _: controller.observe(position))
    seeing = first_plan(lambda controller, position, velocity: controller.observe(position, velocity + error))
    start = [plan.velocities[0] - 0.2 * plan.controls[0] for plan in (seeing, blind)]
    np.testing.assert_allclose(start[0] - start[1], [0.05, 0.0, -0.05], atol=1e-12)


def test_observing_twice_does_not_move_the_plan_on_twice():
    once = first_plan(lambda controller, position, velocity: controller.observe(position, velocity))

    def twice(controller, position, velocity):
        controller.observe(position + 0.1, 0.5 * velocity)
        controller.observe(position, velocity)

    np.testing.assert_array_equal(first_plan(twice).positions, once.positions)


def test_after_a_reset_the_plan_begins_at_rest():
    def stop(controller, position, _):
        controller.reset()
        controller.observe(position)

    plan = first_plan(stop)
    np.testing.assert_allclose(plan.velocities[0], 0.2 * plan.controls[0])


@pytest.mark.parametrize(("position", "velocity"), [([np.nan, 0, 0], None), ([0, 0, 0], [np.inf, 0, 0])])
def test_an_observation_that_is_not_finite_is_refused(position, velocity):
    with pytest.raises(ObservationError, match="not finite"):
        ErgodicController(SMALL, 0).observe(np.array(position), velocity)


@pytest.mark.parametrize("name", EXPLORERS)
def test_planned_states_can_be_drawn_before_and_after_the_first_command(name):
    explorer = make_explorer(name, SMALL, 0)
    assert explorer.planned_states.shape == (0, 3)
    explorer.next_command(FLAT, WorkspaceSamples(SMALL))
    assert explorer.planned_states.shape == ((10, 3) if "ergodic" in name else (0, 3))
