"""Training runs on a fake device; run by test/model/test_other_device.py in a process of its own."""

from contextlib import contextmanager

import numpy as np
import pytest
import torch

from embodied_active_learning.model import learner
from embodied_active_learning.model.loss import PlainLoss
from embodied_active_learning.pipeline.training import TrainingRun
from embodied_active_learning.session.checkpoints import load_latest
from other_device import NAME
from training_thread import STEPS, TIMEOUT, configured, hand_over, observation, training


@contextmanager
def learners_on(device):
    """Build learners for a device, with the same loss function on either."""
    with pytest.MonkeyPatch.context() as patch:
        if device == "cpu":
            patch.setattr(learner, "choose_device", lambda _: torch.device("cpu"))
            patch.setattr(learner, "choose_loss", lambda *_: PlainLoss("plain"))
        yield


def devices(run):
    """Device types of a run's weights."""
    return {tensor.device.type for tensor in weights(run).values()}


def weights(run):
    return run._learner.network.state_dict()


def learn(configuration, indices):
    """Train a run on observations; return the run, its reports and its final responses."""
    run = TrainingRun(configuration)
    with training(run) as (reports, finished, errors):
        hand_over(run, indices)
        assert finished.wait(TIMEOUT)
        assert not errors
        states = np.array([observation(index)[2] for index in range(6)])
        log_std, _, _ = run.log_std(states, run.updates, TIMEOUT)
        means, stds, _ = run.encode(states, [observation(index)[3] for index in range(6)])
    return run, reports, np.concatenate([log_std, means.ravel(), stds.ravel()])


def test_fake_device_rejects_cpu_tensors():
    ours, theirs = torch.ones(2, 2, device=NAME), torch.ones(2, 2)
    with pytest.raises(RuntimeError, match="same device"):
        ours + theirs
    with pytest.raises(RuntimeError, match="a tensor of the CPU in aten::mm"):
        ours @ theirs
    with pytest.raises(TypeError, match="can't convert"):
        ours.numpy()


def test_training_on_device_matches_cpu(tmp_path):
    there, reports, answers = learn(configured(tmp_path / "there"), range(STEPS))
    with learners_on("cpu"):
        here, expected_reports, expected_answers = learn(configured(tmp_path / "here"), range(STEPS))
    assert (devices(there), devices(here)) == ({NAME}, {"cpu"})
    assert len(reports) == len(expected_reports) == 2 * STEPS
    for report, expected in zip(reports, expected_reports):
        assert vars(report) == pytest.approx(vars(expected), rel=1e-4, abs=1e-5)
    assert answers == pytest.approx(expected_answers, abs=1e-4)
    for name, tensor in weights(there).items():
        torch.testing.assert_close(tensor.cpu(), weights(here)[name], rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize(("begun", "continued"), [("cpu", NAME), (NAME, "cpu")])
def test_training_resumes_on_another_device(tmp_path, begun, continued):
    with learners_on(begun):
        first = TrainingRun(configured(tmp_path))
    with training(first):
        hand_over(first, range(10))
        first.log_std(np.zeros((1, 3)), 14, TIMEOUT)
    saved = load_latest(tmp_path / "run" / "checkpoints")
    with learners_on(continued):
        again = TrainingRun(configured(tmp_path, resume=True))
    assert (devices(first), devices(again)) == ({begun}, {continued})
    tensors, counters = again._learner.state_dict()
    assert counters["updates"] == 14
    assert tensors.keys() == saved.tensors.keys()
    for name, tensor in tensors.items():
        torch.testing.assert_close(tensor, saved.tensors[name], rtol=0.0, atol=0.0)
    with training(again) as (_, finished, errors):
        hand_over(again, range(10, STEPS))
        assert finished.wait(TIMEOUT)
        assert not errors
    assert again.updates == 2 * STEPS
