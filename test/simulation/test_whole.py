"""Arm, camera and disturbances together: one seed gives one result."""

from __future__ import annotations

import dataclasses

import numpy as np
import pybullet
import pytest

from embodied_active_learning.config import Config, ExplorationConfig, WorkspaceConfig
from embodied_active_learning.errors import CommandError, ConfigError
from embodied_active_learning.exploration.commands import PoseCommand, VelocityCommand
from embodied_active_learning.simulation.disturbance import Disturbance
from embodied_active_learning.simulation.simulation import Simulation
from embodied_active_learning.simulation.world import Disturbances, load_world

CONFIG = Config()
WORLD = load_world("diagonal", CONFIG.workspace.box())
NOISY = dataclasses.replace(WORLD, disturbances=Disturbances(5.0, 0.1, (0.01, 0.01, 0.1)))
ROUTE = [(0.1, 0.05, 0.5), (-0.05, 0.1, -1.0), (0.0, -0.1, 0.3)]


def with_seed(seed):
    return dataclasses.replace(CONFIG, exploration=ExplorationConfig(seed=seed))


def run(world, config):
    """Return poses and images along the route."""
    with Simulation(world, config) as simulation:
        steps = [(simulation.move(velocity, 0.2).state, simulation.image()) for velocity in ROUTE]
    return np.array([step[0] for step in steps]), np.array([step[1] for step in steps])


@pytest.mark.parametrize("world", [WORLD, NOISY])
def test_one_seed_gives_one_result(world):
    for first, second in zip(run(world, with_seed(3)), run(world, with_seed(3))):
        np.testing.assert_array_equal(first, second)


def test_commands_of_explorers_are_executed():
    with Simulation(WORLD, CONFIG) as simulation:
        moved = simulation.execute(VelocityCommand(*ROUTE[0], 0.2))
        np.testing.assert_array_equal(moved.state, run(WORLD, CONFIG)[0][0])
        reached = simulation.execute(PoseCommand(0.45, 0.05, 0.3))
        np.testing.assert_allclose(reached.state, (0.45, 0.05, 0.3), atol=0.005)


def test_seed_changes_noise_only():
    for first, second in zip(run(WORLD, with_seed(1)), run(WORLD, with_seed(2))):
        np.testing.assert_array_equal(first, second)
    for first, second in zip(run(NOISY, with_seed(1)), run(NOISY, with_seed(2))):
        assert np.any(first != second)


def test_image_shows_object_below_arm():
    with Simulation(WORLD, CONFIG) as simulation:
        duck = simulation.objects[0]
        simulation.go_to((*duck.centre, 0.0))
        red, _, blue = simulation.image()[70:110, 70:110].reshape(-1, 3).mean(axis=0)
    assert red > 150
    assert blue < 60


def test_image_noise_has_configured_strength():
    with Simulation(dataclasses.replace(WORLD, disturbances=Disturbances(image_noise=5.0)), CONFIG) as simulation:
        noisy = simulation.image().astype(float)
    with Simulation(WORLD, CONFIG) as simulation:
        clean = simulation.image().astype(float)
    assert np.std(noisy - clean) == pytest.approx(5.0, rel=0.05)


def test_brightness_drifts_slowly_around_nominal():
    image = np.full((2, 2, 3), 100, np.uint8)
    levels = []
    for seed in range(100):
        disturbance = Disturbance(Disturbances(brightness_drift=0.1), seed)
        first, again, soon = (disturbance.image(image, time).mean() for time in (0.0, 0.0, 0.2))
        assert again == first
        assert abs(soon - first) < 5.0
        levels.append(first / 100.0)
    assert np.mean(levels) == pytest.approx(1.0, abs=0.03)
    assert np.std(levels) == pytest.approx(0.1, rel=0.3)


def test_actuation_noise_stays_within_limits():
    box = CONFIG.workspace.box()
    world = dataclasses.replace(WORLD, disturbances=Disturbances(actuation_noise=(0.05, 0.05, 0.5)))
    with Simulation(world, CONFIG) as simulation:
        speeds = []
        for _ in range(30):
            simulation.go_to(CONFIG.simulation.start)  # far from the border
            speeds.append(simulation.move((0.05, 0.0, 0.0), 0.2).velocity)
        for _ in range(20):
            assert box.contains(simulation.move((0.15, 0.15, 1.5), 0.3).state)
    speeds = np.array(speeds)
    assert np.all(np.abs(speeds) <= 1.01 * np.array([0.15, 0.15, 1.5]))
    assert np.mean(speeds[:, 0]) == pytest.approx(0.05, abs=0.02)
    np.testing.assert_allclose(np.std(speeds, axis=0), [0.05, 0.05, 0.5], rtol=0.35)


def test_rejected_command_changes_nothing():
    with Simulation(NOISY, CONFIG) as simulation:
        with pytest.raises(CommandError):
            simulation.move((np.nan, 0.0, 0.0), 0.2)
        after_refusal = simulation.move(ROUTE[0], 0.2).state
    with Simulation(NOISY, CONFIG) as simulation:
        np.testing.assert_array_equal(simulation.move(ROUTE[0], 0.2).state, after_refusal)


def test_time_advances_only_with_commands():
    with Simulation(WORLD, CONFIG) as simulation:
        assert simulation.time == 0.0
        simulation.move((0.05, 0.0, 0.0), 0.2)
        simulation.image()
        assert simulation.time == 0.2
        np.testing.assert_allclose(simulation.velocity, [0.05, 0.0, 0.0], atol=1e-3)
        assert np.abs(simulation.stop().velocity).max() < 1e-3
        assert len(simulation.joint_positions) == len(simulation.joint_velocities) == 7


def test_close_frees_clients_and_is_idempotent():
    clients = [pybullet.isConnected(number) for number in range(64)]
    with Simulation(WORLD, CONFIG) as simulation:
        pass
    simulation.close()
    assert [pybullet.isConnected(number) for number in range(64)] == clients


def test_failed_start_frees_clients():
    clients = [pybullet.isConnected(number) for number in range(64)]
    with pytest.raises(ConfigError, match="the Panda cannot hold"):
        Simulation(WORLD, dataclasses.replace(CONFIG, workspace=WorkspaceConfig(x=(0.325, 1.5))))
    assert [pybullet.isConnected(number) for number in range(64)] == clients
