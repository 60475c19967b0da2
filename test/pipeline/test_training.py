"""Training run: stores observations, trains in its thread, answers queries meanwhile, and resumes after a stop."""

import numpy as np
import pytest

from embodied_active_learning.errors import ObservationError, SessionError
from embodied_active_learning.pipeline.training import TrainingRun
from embodied_active_learning.session.checkpoints import load_model
from training_thread import STEPS, TIMEOUT, configured, hand_over, observation, training


def test_updates_keep_their_ratio_to_observations(tmp_path):
    run = TrainingRun(configured(tmp_path))
    with training(run) as (reports, _, errors):
        hand_over(run, range(9))
        run.log_std(np.zeros((1, 3)), 12, TIMEOUT)
        run.save()  # by the training thread, once it has reported
        assert run.updates == 2 * (9 + 1 - 4)
        assert [report.update for report in reports] == list(range(1, 13))
        assert not run.finished
        assert not errors


def test_finished_run_writes_model_tables_and_checkpoint(tmp_path):
    run = TrainingRun(configured(tmp_path))
    with training(run) as (_, finished, errors):
        hand_over(run, range(STEPS))
        assert finished.wait(TIMEOUT)
        assert not errors
        assert run.finished
        assert run.updates == 2 * STEPS
    weights, facts = load_model(tmp_path / "run" / "model.safetensors")
    assert sum(tensor.numel() for tensor in weights.values()) > 10000
    assert facts["updates"] == 2 * STEPS
    assert len((tmp_path / "run" / "training.csv").read_text().splitlines()) == 2 * STEPS + 1
    assert len((tmp_path / "run" / "evaluation.csv").read_text().splitlines()) == 4 + 1


def test_log_std_is_none_before_first_update(tmp_path):
    run = TrainingRun(configured(tmp_path))
    with training(run):
        hand_over(run, range(2))
        assert run.log_std(np.zeros((5, 3)), 0) == (None, 0, True)


def test_log_std_times_out_without_the_requested_update(tmp_path):
    run = TrainingRun(configured(tmp_path))
    with training(run):
        hand_over(run, range(5))
        values, _, ready = run.log_std(np.zeros((5, 3)), 1000, timeout=0.1)
        assert values is None
        assert not ready


def test_log_std_and_latents_come_from_newest_model(tmp_path):
    run = TrainingRun(configured(tmp_path))
    with training(run):
        hand_over(run, range(8))
        states = np.array([observation(index)[2] for index in range(6)])
        log_std, updates, ready = run.log_std(states, 10, TIMEOUT)
        assert ready
        assert updates == 10
        assert log_std.shape == (6,)
        assert np.all(np.isfinite(log_std))
        means, stds, updates = run.encode(states, [observation(index)[3] for index in range(6)])
        assert means.shape == stds.shape == (6, 16)
        assert np.all(stds > 0.0)


def test_encoding_nothing_is_an_error(tmp_path):
    run = TrainingRun(configured(tmp_path))
    with training(run), pytest.raises(ObservationError, match="0 images and 0 states"):
        run.encode(np.empty((0, 3)), [])


def test_repeated_observation_counts_once(tmp_path):
    run = TrainingRun(configured(tmp_path))
    with training(run):
        hand_over(run, [0, 1, 1, 0, 2])
        assert run.observations == 3


def test_checkpoint_can_be_requested_while_training(tmp_path):
    run = TrainingRun(configured(tmp_path))
    with training(run):
        hand_over(run, range(6))
        assert run.save(TIMEOUT).exists()


def test_unchanged_checkpoint_is_not_rewritten(tmp_path):
    run = TrainingRun(configured(tmp_path))
    with training(run) as (_, finished, _):
        hand_over(run, range(STEPS))
        assert finished.wait(TIMEOUT)
        (path,) = run.folder.glob(f"checkpoints/*{2 * STEPS}.safetensors")
        written = path.stat().st_mtime_ns
        assert run.save(TIMEOUT) == path
        assert path.stat().st_mtime_ns == written
        path.unlink()
        assert run.save(TIMEOUT) == path
        written = path.stat().st_mtime_ns
    assert path.stat().st_mtime_ns == written


def test_session_in_use_cannot_be_opened_again(tmp_path):
    run = TrainingRun(configured(tmp_path))
    with training(run), pytest.raises(SessionError, match="in use"):
        TrainingRun(configured(tmp_path, resume=True))
