"""Rounds of a trainer and its workers: numbering, reproducibility, joining, failures, resuming."""

import os
import signal
import subprocess
import threading
import time
from contextlib import contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

import training_thread
from embodied_active_learning.config import Config
from embodied_active_learning.distributed import remote_worker
from embodied_active_learning.distributed.link import LinkError, connect_store
from embodied_active_learning.distributed.local import start_workers
from embodied_active_learning.distributed.messages import ROUND, Header
from embodied_active_learning.distributed.worker import TrainerWorker, serve
from embodied_active_learning.objects.stability import Measurement
from embodied_active_learning.pipeline import stopping
from embodied_active_learning.pipeline.learning import BackgroundTraining
from embodied_active_learning.pipeline.training import TrainingRun
from embodied_active_learning.session.session import Session
from tiny import STEPS, TINY
from training_thread import TIMEOUT, hand_over, training

HOST = "127.0.0.1"
START = 300.0  # s, for processes on a busy machine
UPDATES = 3 * STEPS


@pytest.fixture(autouse=True)
def threads():
    """Restore the number of threads, which trainers set for their process."""
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


def configured(root, trainers=3, updates_per_round=4, worker_timeout=TIMEOUT, **session):
    several = {"trainers": trainers, "updates_per_round": updates_per_round, "worker_timeout": worker_timeout}
    training = {**TINY["training"], **several, "threads": 1, "updates_per_observation": 3}
    return training_thread.configured(root, {**TINY, "training": training}, **session)


def test_header_round_trip_keeps_types():
    header = Header(ROUND, start=3, end=2**40, step=4, slot=2, rollbacks=1, with_moments=1, beta=1e-4, gamma=0.1)
    received = Header.from_tensor(header.tensor())
    assert received == header
    assert list(map(type, received)) == list(map(type, header))


def test_header_lists_the_updates_of_its_trainer():
    assert list(Header(ROUND, start=3, end=12, step=4).updates) == [3, 7, 11]


@contextmanager
def workers(run, count):
    """Workers in threads of this process."""
    stop = threading.Event()
    arguments = (lambda: run.pool.address, HOST, stop)
    threads = [threading.Thread(target=serve, args=arguments, kwargs={"retry_period": 0.05}) for _ in range(count)]
    for thread in threads:
        thread.start()
    yield
    stop.set()
    if run.pool is not None:
        run.pool.close()  # wakes them
    for thread in threads:
        thread.join(TIMEOUT)


@contextmanager
def faulty_worker(run, spoil):
    """A worker that calls spoil(weights) before it answers with the weights of a round."""

    class Faulty(TrainerWorker):
        def _train(self, header):
            made = super()._train(header)
            spoil(self._weights)
            return made

    worker = Faulty(run.pool.address, HOST)

    def train():
        with suppress(LinkError):
            worker.run(threading.Event())

    thread = threading.Thread(target=train)
    thread.start()
    wait_for_worker(run)
    yield worker
    thread.join(TIMEOUT)


def wait_for_worker(run):
    ends_at = time.monotonic() + START
    while not run.pool.status():
        assert time.monotonic() < ends_at
        time.sleep(0.01)


def table(run, name):
    return Session.open_read_only(run.folder).read_table(name)


def finish(config, count):
    """Train to the end with this number of workers -> run, closed."""
    run = TrainingRun(config)
    with training(run) as output, workers(run, count):
        hand_over(run, range(len(run.trajectory), STEPS))
        assert output.finished.wait(TIMEOUT)
        assert not output.errors
    return run


def test_trainers_share_updates_in_turn(tmp_path):
    run = finish(configured(tmp_path), 2)
    assert run.updates == UPDATES
    assert table(run, "training")["update"].tolist() == list(range(3, UPDATES + 1, 3))
    rounds = table(run, "rounds")
    assert rounds["update"].tolist() == list(range(12, UPDATES + 1, 12))
    assert set(rounds["trainers"]) == {3}
    assert table(run, "evaluation")["update"].tolist() == [12, 24, 36, 48, 60, 72]


def test_result_depends_on_seed_and_number_of_trainers_only(tmp_path):
    models = [
        (finish(configured(tmp_path / str(index), trainers), trainers - 1).folder / "model.safetensors").read_bytes()
        for index, trainers in enumerate((3, 3, 2))
    ]
    assert models[0] == models[1] != models[2]


def test_owner_trains_alone_without_workers(tmp_path):
    run = finish(configured(tmp_path, worker_timeout=0.1), 0)
    assert run.updates == UPDATES
    assert table(run, "training")["update"].tolist() == list(range(1, UPDATES + 1))
    assert set(table(run, "rounds")["trainers"]) == {1}


def test_late_worker_gets_all_observations_and_takes_part(tmp_path, monkeypatch):
    monkeypatch.setattr(remote_worker, "CHUNK", 4)
    run = TrainingRun(configured(tmp_path, trainers=2))
    run.pool._gathered = True  # waits for nobody
    with training(run) as output:
        hand_over(run, range(20))
        run.log_std(np.zeros((1, 3)), 32, TIMEOUT)
        assert run.updates == 32
        with faulty_worker(run, lambda weights: None) as worker:
            hand_over(run, range(20, STEPS))
            assert output.finished.wait(TIMEOUT)
            run.pool.close()
    assert worker.observations == STEPS
    assert worker.rounds > 0
    assert table(run, "rounds")["trainers"][-1] == 2


def test_round_ends_without_silent_worker(tmp_path):
    run = TrainingRun(configured(tmp_path, trainers=2))
    answer = threading.Event()
    with training(run) as output, faulty_worker(run, lambda weights: answer.wait(TIMEOUT)):
        run.pool._timeout = 0.1
        hand_over(run, range(STEPS))
        assert output.finished.wait(TIMEOUT)
        assert not output.errors
        assert run.pool.status() == []
        answer.set()
    assert run.updates == UPDATES
    updates = table(run, "training")["update"]
    assert updates.tolist() == sorted(set(updates))
    assert table(run, "rounds")["updates"].sum() == UPDATES
    assert set(table(run, "rounds")["trainers"]) == {1}


def test_result_that_is_not_finite_is_rejected(tmp_path):
    run = TrainingRun(configured(tmp_path, trainers=2))
    with training(run) as output, faulty_worker(run, lambda weights: weights.fill_(float("nan"))):
        hand_over(run, range(STEPS))
        assert output.finished.wait(TIMEOUT)
        assert not output.errors
    assert run.updates == UPDATES
    assert set(table(run, "rounds")["trainers"]) == {1}


@pytest.mark.parametrize("trainers", [1, 2])
def test_run_resumes_with_another_number_of_trainers(tmp_path, trainers):
    run = TrainingRun(configured(tmp_path))
    with training(run), workers(run, 2):
        hand_over(run, range(16))
        run.log_std(np.zeros((1, 3)), 24, TIMEOUT)
    assert run.updates == 24
    resumed = TrainingRun(configured(tmp_path, trainers, resume=True))
    with training(resumed) as output, workers(resumed, trainers - 1):
        hand_over(resumed, range(16, STEPS))
        assert output.finished.wait(TIMEOUT)
    assert (resumed.observations, resumed.updates) == (STEPS, UPDATES)
    rounds = Session.open_read_only(run.folder).read_table("rounds")["trainers"].tolist()
    assert rounds[:2] == [3, 3]
    assert set(rounds[2:]) == ({trainers} if trainers > 1 else set())


def test_run_of_two_trainers_ends_once_objects_are_stable(tmp_path, monkeypatch):
    """The planner is in lock-step, so that the same run ends after the same steps."""

    def measure(config, model, evaluation, coverage, stored):
        centres = np.array([[0.4, 0.0], [0.5, 0.1]])
        return Measurement(evaluation.update, evaluation.observations, centres, 0, 5.0, 0.9, 0.9)

    monkeypatch.setattr(stopping, "measure", measure)
    monkeypatch.setattr(stopping, "CHECK_EVERY", 2)
    sections = configured(tmp_path, trainers=2, updates_per_round=3).to_dict()
    sections["exploration"]["stop"] = "stable"

    def steps(name):
        sections["session"]["name"] = name
        run = TrainingRun(Config.from_dict(sections))
        with training(run) as output, workers(run, 1):
            while run.observations < run.config.exploration.steps:
                hand_over(run, [run.observations])
                awaited = run.config.update_plan.awaited(run.observations)
                assert run.log_std(np.zeros((1, 3)), awaited, TIMEOUT)[2]
            assert output.finished.wait(TIMEOUT)
        assert run.updates == 3 * run.observations
        assert set(table(run, "rounds")["trainers"]) == {2}
        return run.observations

    assert steps("first") == steps("second") < STEPS


def test_killed_and_frozen_workers_are_replaced(tmp_path):
    run = TrainingRun(configured(tmp_path, worker_timeout=START))
    with start_workers(2, run.pool.address) as local, training(run) as output:
        hand_over(run, range(12))
        run.log_std(np.zeros((1, 3)), 12, START)
        killed, frozen = local
        killed.kill()
        os.kill(frozen.pid, signal.SIGSTOP)
        run.pool._timeout = 0.2
        hand_over(run, range(12, 16))
        run.log_std(np.zeros((1, 3)), 24, START)
        assert run.pool.status() == []
        run.pool._timeout = START
        os.kill(frozen.pid, signal.SIGCONT)
        wait_for_worker(run)
        hand_over(run, range(16, STEPS))
        assert output.finished.wait(START)
        assert not output.errors
    assert (run.observations, run.updates) == (STEPS, UPDATES)
    assert table(run, "rounds")["trainers"].tolist()[0] == 3
    assert table(run, "rounds")["trainers"].tolist()[-1] == 2


def test_failed_start_of_a_worker_ends_others_and_run(tmp_path, monkeypatch):
    killed, children = [], [SimpleNamespace(wait=lambda: None, kill=lambda: killed.append(1))]

    def start(_command):
        if not children:
            raise OSError("no memory")
        return children.pop()

    monkeypatch.setattr(subprocess, "Popen", start)
    training = BackgroundTraining(configured(tmp_path, trainers=3))
    with pytest.raises(OSError, match="no memory"), training:
        raise AssertionError("not reached")
    assert killed
    Session.open_for_writing(configured(tmp_path, trainers=3, resume=True)).close()  # not locked


def test_workers_dropped_by_a_stop_are_not_logged(tmp_path, caplog):
    run = TrainingRun(configured(tmp_path, trainers=2, worker_timeout=START))
    computing, released = threading.Event(), threading.Event()

    def hang(_weights):
        computing.set()
        released.wait(TIMEOUT)

    with faulty_worker(run, hang):
        with training(run):
            hand_over(run, range(12))
            assert computing.wait(TIMEOUT)
        released.set()
    assert "dropped" not in caplog.text


def test_trainers_listen_on_the_given_address_only(tmp_path):
    def listening():
        sockets = {os.readlink(path) for path in Path("/proc/self/fd").iterdir() if path.is_symlink()}
        rows = [line.split() for name in ("tcp", "tcp6") for line in Path(f"/proc/net/{name}").read_text().splitlines()]
        return {row[1].split(":")[0] for row in rows if row[3] == "0A" and f"socket:[{row[9]}]" in sockets}

    before = listening()
    run = TrainingRun(configured(tmp_path, trainers=2))
    with training(run), workers(run, 1):
        hand_over(run, range(12))
        run.log_std(np.zeros((1, 3)), 8, TIMEOUT)
        assert listening() - before <= {"0100007F"}
        assert "0100007F" in listening()


def test_unreachable_trainer_is_an_error():
    for address in ("127.0.0.1:9", "nonsense", "127.0.0.1:port"):
        with pytest.raises(LinkError):
            connect_store(address)
