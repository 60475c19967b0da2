"""Exploration run: metrics, target, exact resume."""

import numpy as np
import pytest

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CorruptFileError, EmbodiedActiveLearningError
from embodied_active_learning.exploration.baselines import RandomWalkExplorer
from embodied_active_learning.exploration.commands import PoseCommand, VelocityCommand
from embodied_active_learning.exploration.explorer import Explorer
from embodied_active_learning.pipeline.exploration import ExplorationRun, await_log_std, first_command
from embodied_active_learning.registry import EXPLORERS, INFORMATION_MEASURES


def configured(explorer="ergodic", **exploration):
    return Config.from_dict({"exploration": {"explorer": explorer, "samples": 200, "fresh_samples": 20, **exploration}})


def drive(run, config, steps, log_std=None):
    """Let an exact arm execute the run's commands; return the metrics."""
    state = np.array(config.simulation.start)
    velocity = np.zeros(3)
    metrics = []
    for _ in range(steps):
        run.observe(state, velocity)
        metrics.append(run.evaluate_step(None if log_std is None else log_std(run.sample_states)))
        command = run.next_command()
        if isinstance(command, VelocityCommand):
            velocity = command.velocity
            state = state + command.duration * velocity
        else:
            state, velocity = command.state, np.zeros(3)
        assert config.workspace.box().contains(state, tolerance=1e-9)
    return metrics


@pytest.mark.parametrize("explorer", ["ergodic", "random_walk", "uniform", "uniform_ergodic", "active"])
def test_explorers_increase_coverage(explorer):
    config = configured(explorer)
    metrics = drive(ExplorationRun(config), config, 60)
    assert metrics[-1].step == 60
    assert metrics[-1].coverage > metrics[0].coverage
    assert metrics[-1].ergodic_measure < metrics[0].ergodic_measure
    assert metrics[-1].distance > 0.1
    assert metrics[-1].turning > 0.1


class MethodExplorer(RandomWalkExplorer):
    """planned_states is a method instead of a property."""

    def planned_states(self):
        return np.empty((0, 3))


class IncompleteExplorer(Explorer):
    """Implements nothing."""


@pytest.mark.parametrize(
    ("explorer", "problem"), [(MethodExplorer, "make it a property"), (IncompleteExplorer, "takes no arguments")]
)
def test_incomplete_explorer_is_named(explorer, problem):
    EXPLORERS.register("test_incomplete")(explorer)
    try:
        with pytest.raises(EmbodiedActiveLearningError, match=f"explorer test_incomplete cannot be used: .*{problem}"):
            ExplorationRun(configured("test_incomplete"))
    finally:
        EXPLORERS.unregister("test_incomplete")


class FailingExplorer(RandomWalkExplorer):
    """Its constructor has a mistake."""

    def __init__(self, config, seed):
        super().__init__(config, seed)
        self.grid = np.linspace(0.0, 1.0, "10")


def test_mistake_in_constructor_keeps_its_traceback():
    EXPLORERS.register("test_failing")(FailingExplorer)
    try:
        with pytest.raises(TypeError) as raised:
            ExplorationRun(configured("test_failing"))
    finally:
        EXPLORERS.unregister("test_failing")
    assert "np.linspace" in str(raised.getrepr())


def test_command_of_another_type_is_an_error():
    run = ExplorationRun(configured("uniform"))
    run.observe(np.array([0.4, 0.0, 0.0]), np.zeros(3))
    run.evaluate_step(None)
    run._explorer.next_command = lambda *_arguments: (0.4, 0.0, 0.0)
    with pytest.raises(EmbodiedActiveLearningError, match="expected a PoseCommand or VelocityCommand"):
        run.next_command()


@pytest.mark.parametrize(
    ("target", "problem"),
    [
        (lambda log_std: log_std - 10.0, "negative values"),
        (lambda log_std: np.full((len(log_std), 1), 1.0), r"shape \(200, 1\)"),
        (lambda log_std: log_std * np.nan, "values that are not finite"),
        (lambda log_std: 0.0 * log_std, "only zeros"),
    ],
)
def test_measure_that_returns_no_distribution_is_an_error(target, problem):
    INFORMATION_MEASURES.register("test_invalid")(lambda log_std, coverage: target(log_std))
    try:
        run = ExplorationRun(configured("random_walk", measure="test_invalid"))
        run.observe(np.array([0.4, 0.0, 0.0]), np.zeros(3))
        with pytest.raises(EmbodiedActiveLearningError, match=f"exploration/measure. returned {problem}: return 200"):
            run.evaluate_step(np.ones(200))
    finally:
        INFORMATION_MEASURES.unregister("test_invalid")


def test_distance_and_turning_sum_state_changes():
    config = configured()
    run = ExplorationRun(config)
    for state in ([0.4, 0.0, 0.0], [0.43, 0.04, -0.5], [0.43, 0.04, 0.5]):
        run.observe(np.array(state), np.zeros(3))
    metrics = run.evaluate_step(None)
    assert metrics.distance == pytest.approx(0.05)
    assert metrics.turning == pytest.approx(1.5)


def test_effort_integrates_squared_acceleration():
    config = configured()
    run = ExplorationRun(config)
    run.observe(np.array(config.simulation.start), np.zeros(3))
    run.evaluate_step(None)
    velocity = run.next_command().velocity
    run.observe(np.array(config.simulation.start) + 0.2 * velocity, velocity)
    expected = np.sum((velocity / np.array([0.15, 0.15, 2.0]) / 0.2) ** 2) * 0.2
    assert run.evaluate_step(None).effort == pytest.approx(expected)


def test_effort_nan_for_pose_commands():
    config = configured("uniform")
    run = ExplorationRun(config)
    assert np.isnan(drive(run, config, 3)[-1].effort)
    assert isinstance(run.next_command(), PoseCommand)


def test_target_flat_at_first_then_peaks_at_uncertainty():
    config = configured()
    run = ExplorationRun(config)
    run.observe(np.array(config.simulation.start), np.zeros(3))
    assert np.ptp(run.evaluate_step(None).target) == 0.0
    corner = np.array([0.6, 0.12])
    distance = np.linalg.norm(run.sample_states[:, :2] - corner, axis=1)
    target = run.evaluate_step(-10.0 * distance).target
    assert np.argmax(target) == np.argmin(distance)
    assert target.sum() == pytest.approx(1.0)


def test_diverged_model_rejected():
    config = configured()
    run = ExplorationRun(config)
    run.observe(np.array(config.simulation.start), np.zeros(3))
    with pytest.raises(EmbodiedActiveLearningError, match="diverged"):
        run.evaluate_step(np.full(200, np.nan))


def test_run_resumed_from_trajectory_continues_metrics():
    config = configured("random_walk")
    whole = ExplorationRun(config)
    last = drive(whole, config, 30)[-1]
    resumed = ExplorationRun(config, whole.travelled_states[:-1], effort=last.effort)
    resumed.observe(whole.travelled_states[-1], np.zeros(3))
    again = resumed.evaluate_step(None)
    assert again.step == last.step
    assert again.distance == pytest.approx(last.distance)
    assert again.turning == pytest.approx(last.turning)
    assert again.effort == pytest.approx(last.effort)
    assert again.coverage == pytest.approx(last.coverage, rel=0.1)  # other samples, the same trajectory
    assert again.ergodic_measure == pytest.approx(last.ergodic_measure, rel=0.2)


@pytest.mark.parametrize("explorer", ["ergodic", "random_walk", "uniform", "uniform_ergodic", "active"])
def test_run_with_loaded_state_is_bit_identical(explorer):
    config = configured(explorer)
    whole = ExplorationRun(config)
    state, velocity, command = np.array(config.simulation.start), np.zeros(3), None
    resumed = None
    for step in range(40):
        if step == 25:
            resumed = ExplorationRun(config, whole.travelled_states)
            resumed.load_state_dict(whole.state_dict())
        runs = [whole] if resumed is None else [whole, resumed]
        for run in runs:
            run.observe(state, velocity)
        metrics = [run.evaluate_step(np.sin(5.0 * run.sample_states).sum(axis=1)) for run in runs]
        commands = [run.next_command() for run in runs]
        assert len(set(commands)) == 1
        assert len({(a.coverage, a.ergodic_measure, a.distance, a.turning, str(a.effort)) for a in metrics}) == 1
        np.testing.assert_array_equal(runs[0].sample_states, runs[-1].sample_states)
        command = commands[0]
        if isinstance(command, VelocityCommand):
            state, velocity = state + command.duration * command.velocity, command.velocity
        else:
            state, velocity = command.state, np.zeros(3)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda state: state.pop("samples/states"), "no array 'states'"),
        (lambda state: state.update({"explorer/controls": np.zeros((3, 3))}), "array 'controls' is"),
        (lambda state: state.update({"sums": np.zeros(3, np.float32)}), "array 'sums' is float32"),
        (lambda state: state.update(step=np.array([4])), "of step 4, the stored trajectory of step 5"),
    ],
)
def test_state_dict_that_does_not_fit_rejected_by_name(change, words):
    config = configured()
    run = ExplorationRun(config)
    drive(run, config, 5)
    state = run.state_dict()
    change(state)
    with pytest.raises(CorruptFileError, match=words):
        ExplorationRun(config, run.travelled_states).load_state_dict(state)


def test_plan_after_interruption_starts_at_rest():
    config = configured()
    run = ExplorationRun(config)
    drive(run, config, 20)
    run.interrupt()
    run.observe(np.array(config.simulation.start), np.zeros(3))
    run.evaluate_step(None)
    first = np.abs(run.next_command().velocity)
    assert np.all(first <= np.array([0.15 / 1.25, 0.15 / 1.25, 1.5 / 0.625]) * 0.2 + 1e-9)


def test_query_is_repeated_until_the_model_is_the_awaited_one():
    """The first response is of an older model, the second ends the exploration, so that all updates are awaited."""
    configs, asked = [Config()], []

    def query(min_updates):
        asked.append(min_updates)
        if len(asked) == 2:
            configs.append(Config().with_steps(100))
        return np.full(3, len(asked)), len(asked) > 1

    assert await_log_std(lambda: configs[-1], 10, query) is None
    assert asked == []
    assert await_log_std(lambda: configs[-1], 100, query).tolist() == [3.0] * 3
    assert asked == [108, 108, 300]


def test_first_command_returns_to_the_last_state():
    assert first_command(Config(), np.empty((0, 3))) == VelocityCommand(0.0, 0.0, 0.0, 0.2)
    assert first_command(Config(), np.array([[0.4, 0.0, 0.0], [0.5, 0.1, 0.2]])) == PoseCommand(0.5, 0.1, 0.2)
