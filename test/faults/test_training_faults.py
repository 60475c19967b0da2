"""Training when arithmetic fails, and when it is ended and begun again: good weights, and one result."""

import threading
from contextlib import contextmanager

import numpy as np
import pytest
import torch

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.model import learner as learner_module
from embodied_active_learning.model.learner import ATTEMPTS
from embodied_active_learning.pipeline.training import ROLLBACKS, TrainingRun
from embodied_active_learning.session.checkpoints import load_model
from embodied_active_learning.session.observations import DATA_FILE
from training_thread import TIMEOUT, hand_over, observation, training

STEPS = 24


def configured(root, **session):
    return Config.from_dict(
        {
            "camera": {"width": 45, "height": 45},
            "training": {
                "batch_size": 4,
                "first_update_at": 4,
                "updates_per_observation": 3,
                "evaluate_every": 7,
                "checkpoint_every": 10,
            },
            "objective": {"schedule_every": 5},
            "exploration": {"steps": STEPS, "samples": 50, "fresh_samples": 5},
            "session": {"name": "run", "root": str(root), **session},
        }
    )


def learn(run, last):
    """Hand over observations up to number `last` and ask, as a planner does, what each model says."""
    answers = {}
    for index in range(last):
        run.observe(*observation(index))
        awaited = configured("").updates_awaited(index + 1)
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
    """What training says that ends with an error."""
    with training(run) as (_, finished, errors):
        hand_over(run, range(STEPS))
        assert finished.wait(TIMEOUT)
    return str(errors[0])


def outcome(folder):
    weights, _ = load_model(folder / "model.safetensors")
    tables = [(folder / name).read_bytes() for name in ("training.csv", "evaluation.csv")]
    return tables, {name: tensor.numpy().tobytes() for name, tensor in weights.items()}


class FailingLoss:
    """The plain loss, but not a number (or with a gradient that is none) in the calls of these numbers."""

    def __init__(self, arithmetic, calls, what="loss"):
        self._loss = arithmetic.loss
        self._calls = set(calls)
        self._what = what
        self.made = 0

    def __call__(self, network, *arguments):
        # The sum of the gradients is not what becomes of them here.
        loss = self._loss(network, *arguments)._replace(gradient_sum=None)
        self.made += 1
        if self.made - 1 not in self._calls:
            return loss
        if self._what == "loss":
            return loss._replace(total=loss.total * float("nan"))
        if loss.gradients is not None:
            first, *others = loss.gradients
            return loss._replace(gradients=[first * float("inf"), *others])
        weight = next(network.parameters())
        weight.register_hook(lambda gradient: gradient * float("inf"))
        return loss


@pytest.fixture
def failing(monkeypatch):
    """Lets the losses of these calls fail in every learner that is made afterwards."""
    choose = learner_module.choose_arithmetic

    def fail(calls, what="loss"):
        def choose_failing(network, device):
            arithmetic = choose(network, device)
            return arithmetic._replace(loss=FailingLoss(arithmetic, calls, what))

        monkeypatch.setattr(learner_module, "choose_arithmetic", choose_failing)

    return fail


def test_a_loss_that_is_not_a_number_skips_the_batch_and_is_counted(tmp_path, failing):
    failing([3, 4, 17])
    run = TrainingRun(configured(tmp_path))
    finish(run)
    assert (run.skipped, run.rollbacks) == (3, 0)
    assert run.updates == 3 * STEPS
    assert all(torch.isfinite(weight).all() for weight in load_model(run.folder / "model.safetensors")[0].values())


def test_after_several_bad_batches_in_a_row_the_last_good_weights_return_and_training_goes_on(tmp_path, failing):
    failing(range(25, 25 + ATTEMPTS))
    run = TrainingRun(configured(tmp_path))
    finish(run)
    assert (run.skipped, run.rollbacks) == (ATTEMPTS, 1)
    assert run.updates == 3 * STEPS
    updates = [line.split(",")[0] for line in (run.folder / "training.csv").read_text().splitlines()[1:]]
    assert updates == [str(update) for update in range(1, 3 * STEPS + 1)]


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_what_fails_behind_the_last_update_ends_training_though_nobody_hands_over_more(tmp_path):
    run = TrainingRun(configured(tmp_path))
    take = run._learner.snapshots.take

    def fail(weights, updates):
        if updates == 6:
            raise RuntimeError("no memory")
        take(weights, updates)

    run._learner.snapshots.take = fail
    with training(run) as (_, finished, errors):
        hand_over(run, range(5))
        assert finished.wait(TIMEOUT)
    assert "no memory" in str(errors[0])


def test_bad_batches_before_the_first_checkpoint_lead_back_to_the_beginning(tmp_path, failing):
    failing(range(2, 2 + ATTEMPTS))
    run = TrainingRun(configured(tmp_path))
    finish(run)
    assert run.rollbacks == 1
    assert run.updates == 3 * STEPS


def test_batches_after_a_rollback_are_others_than_before(tmp_path, failing):
    failing(range(25, 25 + ATTEMPTS))
    run = TrainingRun(configured(tmp_path / "disturbed"))
    finish(run)
    failing([])
    calm = TrainingRun(configured(tmp_path / "calm"))
    finish(calm)
    rows = [(each.folder / "training.csv").read_text().splitlines() for each in (run, calm)]
    assert rows[0][:21] == rows[1][:21]
    assert rows[0][21:] != rows[1][21:]


def test_training_ends_with_the_reason_when_going_back_does_not_help(tmp_path, failing):
    failing(range(25, 10000))
    run = TrainingRun(configured(tmp_path))
    error = failure(run)
    assert "not finite" in error
    assert f"{ROLLBACKS} times" in error
    assert run.rollbacks == ROLLBACKS
    again = TrainingRun(configured(tmp_path, resume=True))
    assert (again.updates, again.observations) == (20, STEPS)
    again.close()


def test_a_gradient_that_is_not_finite_leaves_the_weights_as_they_were(tmp_path, failing):
    failing(range(1000), "gradient")
    run = TrainingRun(configured(tmp_path))
    error = failure(run)
    assert "not finite" in error
    assert all(torch.isfinite(weight).all() for weight in run._learner.network.parameters())


@pytest.mark.parametrize("last", [5, 9, 13, 20])
def test_stopping_anywhere_and_going_on_gives_the_same_answers_tables_and_weights_as_not_stopping(tmp_path, last):
    whole = TrainingRun(configured(tmp_path / "whole"))
    answers = finish(whole)
    first = TrainingRun(configured(tmp_path / "stopped"))
    with training(first):
        said = learn(first, last)
    again = TrainingRun(configured(tmp_path / "stopped", resume=True))
    assert again.observations == last
    said.update(finish_from(again, last))
    assert said == answers
    assert outcome(whole.folder) == outcome(again.folder)


@contextmanager
def all_due_is_made(run, stop_at=None):
    """The run with every update made that is due, or those before it was stopped at one; closed when the block ends."""
    stop, answers = threading.Event(), threading.Event()

    def on_update(report):
        if report.update == stop_at:
            stop.set()
        if stop.is_set() or report.update == run.updates_due:
            answers.set()

    thread = threading.Thread(target=run.train, args=(stop, on_update, lambda: None))
    thread.start()
    try:
        assert answers.wait(TIMEOUT)
        yield
    finally:
        stop.set()
        run.wake()
        thread.join(TIMEOUT)
        run.close()


@pytest.mark.parametrize("behind", [1, 2, 3])
def test_a_trainer_that_was_stopped_between_two_observations_answers_with_the_model_that_is_asked_for(tmp_path, behind):
    count, states = 12, np.linspace(-0.1, 0.1, 12).reshape(4, 3)
    config = configured("")
    awaited = config.updates_awaited(count)

    def begun(name, **session):
        run = TrainingRun(configured(tmp_path / name, **session))
        for index in range(run.observations, count):
            run.observe(*observation(index))
        return run

    whole = begun("whole")
    with all_due_is_made(whole):
        expected = whole.log_std(states, awaited)
    with all_due_is_made(begun("stopped"), stop_at=config.updates_due(count) - behind):
        pass
    again = begun("stopped", resume=True)
    with all_due_is_made(again):
        values, *rest = again.log_std(states, awaited)
    assert rest == [awaited, True]
    np.testing.assert_array_equal(values, expected[0])


def finish_from(run, last):
    """Go on as a planner does: it asks again about the newest observation, which it may not have heard about."""
    answers = {}
    with training(run) as (_, finished, _):
        for index in range(last - 1, STEPS):
            run.observe(*observation(index))
            awaited = configured("").updates_awaited(index + 1)
            values, updates, ready = run.log_std(np.linspace(-0.1, 0.1, 12).reshape(4, 3), awaited, TIMEOUT)
            assert ready
            assert updates == awaited
            answers[index] = values.tolist()
        assert finished.wait(TIMEOUT)
    return answers


def test_a_checkpoint_whose_observations_are_gone_is_not_trained_on(tmp_path):
    run = TrainingRun(configured(tmp_path))
    finish(run)
    (run.folder / "observations" / DATA_FILE).unlink()
    with pytest.raises(CorruptFileError, match=f"holds 0 observations, but there were {STEPS} when checkpoint_"):
        TrainingRun(configured(tmp_path, resume=True))


@pytest.mark.parametrize(
    "damage",
    [
        {"generator": {"bit_generator": "PCG64"}},
        {"schedule": {"window": [1]}},
        {"updates": "many"},
        {"earlier_updates": None},
    ],
)
def test_counters_that_are_none_are_refused_by_name(tmp_path, damage):
    run = TrainingRun(configured(tmp_path))
    finish(run)
    tensors, counters = run._learner.state()
    with pytest.raises(CorruptFileError, match="checkpoint has counters that cannot be used"):
        run._learner.restore(tensors, {**counters, **damage})
