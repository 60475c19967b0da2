"""Training with non-finite losses, and training that is stopped and resumed with the same result."""

import dataclasses
import shutil
import threading
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
import pytest
import torch

import training_thread
from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.model import learner as learner_module
from embodied_active_learning.model.learner import ATTEMPTS
from embodied_active_learning.model.learner_state import LearnerState
from embodied_active_learning.pipeline.run_checkpoints import ROLLBACKS
from embodied_active_learning.pipeline.training import TrainingRun
from embodied_active_learning.session.checkpoints import load_model
from embodied_active_learning.session.observations import DATA_FILE
from training_thread import TIMEOUT, hand_over, observation, training

STEPS = 24


def configured(root, **session):
    changes = {
        "training": {"updates_per_observation": 3, "evaluate_every": 7, "checkpoint_every": 10},
        "objective": {"schedule_every": 5},
        "exploration": {"steps": STEPS},
    }
    return training_thread.configured(root, changes, **session)


def learn(run, last):
    """Pass observations up to number `last` to a run and query each model, as the planner does."""
    answers = {}
    for index in range(last):
        run.observe(*observation(index))
        awaited = configured("").update_plan.awaited(index + 1)
        values, updates, ready = run.log_std(np.linspace(-0.1, 0.1, 12).reshape(4, 3), awaited, TIMEOUT)
        assert ready
        if awaited:
            assert updates == awaited
            answers[index] = values.tolist()
    return answers


def finish(run):
    with training(run) as (_, finished, errors):
        answers = learn(run, STEPS)
        assert finished.wait(TIMEOUT)
        assert not errors
    return answers


def failure(run):
    """The error that ends training."""
    with training(run) as (_, finished, errors):
        hand_over(run, range(STEPS))
        assert finished.wait(TIMEOUT)
    return str(errors[0])


def outcome(folder):
    weights, _ = load_model(folder / "model.safetensors")
    tables = [(folder / name).read_bytes() for name in ("training.csv", "evaluation.csv")]
    return tables, {name: tensor.numpy().tobytes() for name, tensor in weights.items()}


class FailingLoss:
    """A loss function whose loss or gradient is not finite in some calls."""

    def __init__(self, loss, calls, what="loss"):
        self._compute = loss.compute_gradients
        self.description, self.torch_threads = loss.description, loss.torch_threads
        self._calls = set(calls)
        self._what = what
        self.made = 0

    def compute_gradients(self, network, *arguments):
        terms = self._compute(network, *arguments)
        self.made += 1
        if self.made - 1 not in self._calls:
            return terms
        if self._what == "loss":
            return terms._replace(total=terms.total * float("nan"))
        first = next(network.parameters())
        first.grad = first.grad * float("inf")
        return terms._replace(gradient_sum=first.grad.sum())


@pytest.fixture
def failing(monkeypatch):
    """Makes these calls of the loss fail in every learner that is built afterwards."""
    choose = learner_module.choose_loss

    def fail(calls, what="loss"):
        monkeypatch.setattr(
            learner_module, "choose_loss", lambda *arguments: FailingLoss(choose(*arguments), calls, what)
        )

    return fail


class Whole(NamedTuple):
    """A run that was neither disturbed nor stopped, its answers, and the state of its learner."""

    run: TrainingRun
    answers: dict
    state: LearnerState


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    run = TrainingRun(configured(tmp_path_factory.mktemp("whole")))
    return Whole(run, finish(run), run._learner.state_dict())


def test_repeated_nan_loss_rolls_back_and_training_continues(tmp_path, failing, whole):
    """It continues with other batches."""
    failing(range(25, 25 + ATTEMPTS))
    run = TrainingRun(configured(tmp_path))
    finish(run)
    assert (run.skipped, run.rollbacks) == (ATTEMPTS, 1)
    assert run.updates == 3 * STEPS
    rows, calm = ((each.folder / "training.csv").read_text().splitlines() for each in (run, whole.run))
    assert [row.split(",")[0] for row in rows[1:]] == [str(update) for update in range(1, 3 * STEPS + 1)]
    assert rows[:21] == calm[:21]
    assert rows[21:] != calm[21:]


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_error_after_last_update_ends_training(tmp_path):
    run = TrainingRun(configured(tmp_path))
    refresh = run._learner.replicas.refresh

    def fail(weights, updates):
        if updates == 6:
            raise RuntimeError("no memory")
        refresh(weights, updates)

    run._learner.replicas.refresh = fail
    with training(run) as (_, finished, errors):
        hand_over(run, range(5))
        assert finished.wait(TIMEOUT)
    assert "no memory" in str(errors[0])


def test_divergence_before_first_checkpoint_restarts_training(tmp_path, failing):
    failing(range(2, 2 + ATTEMPTS))
    run = TrainingRun(configured(tmp_path))
    finish(run)
    assert run.rollbacks == 1
    assert run.updates == 3 * STEPS


def test_training_fails_with_reason_after_all_rollbacks(tmp_path, failing):
    failing(range(25, 10000))
    run = TrainingRun(configured(tmp_path))
    error = failure(run)
    assert "not finite" in error
    assert f"{ROLLBACKS} rollbacks" in error
    assert run.rollbacks == ROLLBACKS
    again = TrainingRun(configured(tmp_path, resume=True))
    assert (again.updates, again.observations) == (20, STEPS)
    again.close()


def test_non_finite_gradient_does_not_change_weights(tmp_path, failing):
    failing(range(1000), "gradient")
    run = TrainingRun(configured(tmp_path))
    error = failure(run)
    assert "not finite" in error
    assert all(torch.isfinite(weight).all() for weight in run._learner.network.parameters())


@pytest.mark.parametrize("last", [5, 13])
def test_resumed_run_equals_uninterrupted_run(tmp_path, whole, last):
    first = TrainingRun(configured(tmp_path))
    with training(first):
        answers = learn(first, last)
    again = TrainingRun(configured(tmp_path, resume=True))
    assert again.observations == last
    answers.update(finish_from(again, last))
    assert answers == whole.answers
    assert outcome(again.folder) == outcome(whole.run.folder)


@contextmanager
def trained(run, stop_at=None):
    """Train a run until all due updates are made or one is reached; closed when the block ends."""
    answers = threading.Event()

    def on_update(report):
        if report.update == stop_at:
            run.stop()
        if report.update in (stop_at, run.updates_due):
            answers.set()

    thread = threading.Thread(target=run.train, args=(on_update,))
    thread.start()
    try:
        assert answers.wait(TIMEOUT)
        yield
    finally:
        run.stop()
        thread.join(TIMEOUT)
        run.close()


@pytest.mark.parametrize("behind", [1, 2, 3])
def test_resumed_trainer_answers_with_the_requested_model(tmp_path, whole, behind):
    count = 12
    config = configured("")
    awaited = config.update_plan.awaited(count)

    def begun(**session):
        run = TrainingRun(configured(tmp_path, **session))
        hand_over(run, range(run.observations, count))
        return run

    with trained(begun(), stop_at=config.update_plan.due(count) - behind):
        pass
    again = begun(resume=True)
    with trained(again):
        values, *rest = again.log_std(np.linspace(-0.1, 0.1, 12).reshape(4, 3), awaited)
    assert rest == [awaited, True]
    assert values.tolist() == whole.answers[count - 1]


def finish_from(run, last):
    """Continue as a planner does after a restart: it repeats the newest observation."""
    answers = {}
    with training(run) as (_, finished, _):
        for index in range(last - 1, STEPS):
            run.observe(*observation(index))
            awaited = configured("").update_plan.awaited(index + 1)
            values, updates, ready = run.log_std(np.linspace(-0.1, 0.1, 12).reshape(4, 3), awaited, TIMEOUT)
            assert ready
            assert updates == awaited
            answers[index] = values.tolist()
        assert finished.wait(TIMEOUT)
    return answers


def test_checkpoint_without_its_observations_is_refused(tmp_path, whole):
    shutil.copytree(whole.run.folder, tmp_path / "run")
    (tmp_path / "run" / "observations" / DATA_FILE).unlink()
    with pytest.raises(CorruptFileError, match=rf"holds 0, but checkpoint_\d+\.safetensors was trained on {STEPS}"):
        TrainingRun(configured(tmp_path, resume=True))


@pytest.mark.parametrize("rate", [0.3, 1.0])
def test_far_too_high_learning_rate_is_named_as_the_cause(tmp_path, rate):
    """The loss stays finite, but grows so large that Adam's moments overflow."""
    config = configured(tmp_path)
    config = dataclasses.replace(config, training=dataclasses.replace(config.training, learning_rate=rate))
    run = TrainingRun(config)
    error = failure(run)
    assert "training diverged" in error
    assert "lower training/learning_rate" in error
    resumed = TrainingRun(configured(tmp_path, resume=True))
    resumed.close()


def test_stop_with_non_finite_weights_keeps_last_good_state(tmp_path):
    run = TrainingRun(configured(tmp_path))
    with training(run) as (_, _, errors):
        learn(run, 6)
        with torch.no_grad():
            next(run._learner.network.parameters()).fill_(float("nan"))
    assert not errors
    assert run.rollbacks == 1


def test_moments_that_are_not_finite_are_not_saved(tmp_path):
    run = TrainingRun(configured(tmp_path))
    with training(run) as (_, _, errors):
        learn(run, 6)
        run._learner.join()
        moments = run._learner.moments()
        run._learner.load_moments(moments.fill_(float("inf")))
        hand_over(run, range(6, STEPS))
        run.log_std(np.zeros((1, 3)), 3 * (STEPS - 4), TIMEOUT)
    assert not errors
    assert run.rollbacks == 1
