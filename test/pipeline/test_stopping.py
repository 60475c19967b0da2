"""Early stop of a training run: when it ends, and that a resumed run decides the same."""

import numpy as np
import pytest

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.objects.stability import EMPTY_CHECKS, STABLE_CHECKS, Measurement
from embodied_active_learning.pipeline import stopping
from embodied_active_learning.pipeline.training import TrainingRun
from embodied_active_learning.session.checkpoints import load_latest, load_model
from training_thread import STEPS, TIMEOUT, configured, hand_over, training

EVERY = 2  # observations between checks
CENTRES = np.array([[0.4, 0.0], [0.5, 0.1]])
FIRST = 4  # observations before the first update


@pytest.fixture(autouse=True)
def quick_checks(monkeypatch):
    """Checks at intervals that fit a tiny run, all of which find the same objects."""
    monkeypatch.setattr(stopping, "CHECK_EVERY", EVERY)
    find(monkeypatch, CENTRES)


def find(monkeypatch, centres):
    """Let every check find objects at these centres (K, 2)."""

    def measure(config, model, evaluation, coverage, stored):
        return Measurement(evaluation.update, evaluation.observations, centres, 0, 5.0, 0.9, 0.9)

    monkeypatch.setattr(stopping, "measure", measure)


def stable(root, **session):
    return Config.from_dict({**configured(root, **session).to_dict(), "exploration": {**EXPLORATION, "stop": "stable"}})


EXPLORATION = configured("").to_dict()["exploration"]


def finish(run, planned=STEPS):
    """Observe like a planner in lock-step until the run has enough steps; return their number."""
    with training(run) as (_, finished, errors):
        while run.observations < run.config.exploration.steps:
            hand_over(run, [run.observations])
            awaited = run.config.update_plan.awaited(run.observations)
            assert run.log_std(np.zeros((1, 3)), awaited, TIMEOUT)[2]
        assert finished.wait(TIMEOUT)
        assert not errors
    return run.observations


def test_run_ends_once_objects_are_stable(tmp_path):
    run = TrainingRun(stable(tmp_path))
    steps = finish(run)
    assert steps == FIRST + EVERY * STABLE_CHECKS
    assert run.updates == 2 * steps
    assert load_model(tmp_path / "run" / "model.safetensors")[1] == {"updates": 2 * steps, "observations": steps}


def test_empty_table_ends_with_nothing_to_learn(tmp_path, monkeypatch):
    find(monkeypatch, np.empty((0, 2)))
    run = TrainingRun(stable(tmp_path))
    assert finish(run) == FIRST + EVERY * EMPTY_CHECKS
    assert run.stop_check.reason == "nothing to learn"


def test_fixed_run_makes_all_steps(tmp_path):
    assert finish(TrainingRun(configured(tmp_path))) == STEPS
    assert not (tmp_path / "run" / "stopping.csv").exists()


def test_resumed_run_ends_after_the_same_steps(tmp_path):
    """It is stopped between two checks, and again after the decision."""
    with training(run := TrainingRun(stable(tmp_path))):
        hand_over(run, range(FIRST + 2 * EVERY))
        assert run.log_std(np.zeros((1, 3)), 2 * (2 * EVERY + 1), TIMEOUT)[2]
    steps = finish(TrainingRun(stable(tmp_path, resume=True)))
    assert steps == FIRST + EVERY * STABLE_CHECKS
    assert len((tmp_path / "run" / "stopping.csv").read_text().splitlines()) == STABLE_CHECKS + 1
    assert finish(TrainingRun(stable(tmp_path, resume=True))) == steps


def test_ended_run_continues_with_fixed_steps(tmp_path):
    finish(TrainingRun(stable(tmp_path)))
    assert finish(TrainingRun(configured(tmp_path, resume=True))) == STEPS


@pytest.mark.parametrize(
    "state", [{}, 3, {"steps": "x", "centres": []}, {"steps": None, "centres": [[1.0]]}, {"steps": None}]
)
def test_invalid_state_is_refused(state):
    early_stop = stopping.EarlyStop(Config())
    with pytest.raises(CorruptFileError, match="stopping criterion"):
        early_stop.load_state_dict(state)


def test_checkpoint_holds_the_decision(tmp_path):
    finish(TrainingRun(stable(tmp_path)))
    counters = load_latest(tmp_path / "run" / "checkpoints").counters
    assert counters["early_stop"]["steps"] == FIRST + EVERY * STABLE_CHECKS
