"""A run whose nodes are killed, frozen and ended one after the other: memory, resuming, shutdown."""

import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest
import yaml

from embodied_active_learning.pipeline.resolve import resolve_config
from embodied_active_learning.session.checkpoints import load_latest
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.summary import read_summary
from launching import ROOT, environment, launched, pid_of
from threads import wait_while_running

sys.path.insert(0, str(ROOT / "experiments"))

import soak

pytestmark = pytest.mark.ros

TINY = ROOT / "test" / "rostest" / "tiny.yaml"
NODES = ("pybullet_arm", "trainer", "ergodic_planner", "fingerprinter", "monitor")
CHECKPOINT_EVERY = 60  # updates
SAMPLES, PERIOD = 40, 0.4
MEMORY = 4.0  # MB by which a node may grow during the second half of the samples
IMAGE = 60 * 60 * 3 / 2**20  # MB of an image of TINY


class Run:
    """A learning run with respawn:=true."""

    def __init__(self, home, process, variables):
        self.path = home / "run"
        self.process = process
        self.began_at = time.monotonic()
        self.variables = variables
        self._log = home / "launch.log"

    @property
    def output(self):
        return self._log.read_text()

    @property
    def steps(self):
        table = self.path / "exploration.csv"
        return len(table.read_text().splitlines()) - 1 if table.exists() else 0

    @property
    def last_update(self):
        return Session.open_read_only(self.path).read_table("training")["update"][-1]

    @property
    def checkpoint(self):
        return load_latest(self.path / "checkpoints")

    def pid(self, node):
        return pid_of(node, self.process.pid)

    def arm_rests(self):
        command = ["rostopic", "echo", "-n1", "/arm/state"]
        response = subprocess.run(command, env=self.variables, capture_output=True, text=True, timeout=30, check=True)
        state = next(yaml.safe_load_all(response.stdout))
        return max(abs(state[key]) for key in ("vx", "vy", "omega")) < 1e-4

    def wait_for(self, condition, timeout=60):
        wait_while_running(self.process, condition, timeout, lambda: self.output)

    def wait_for_progress(self):
        before = self.steps
        self.wait_for(lambda: self.steps > before + 5)

    def wait_for_respawn(self, node, former):
        """Return once a node runs in another process."""

        def is_respawned():
            try:
                return self.pid(node) != former
            except AssertionError:
                return False

        self.wait_for(is_respawned)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    home = tmp_path_factory.mktemp("run")
    profile = yaml.safe_load(TINY.read_text())
    profile["training"]["checkpoint_every"] = CHECKPOINT_EVERY  # a respawned trainer repeats few updates
    (home / "profile.yaml").write_text(yaml.safe_dump(profile))
    values = {"profile": home / "profile.yaml", "session_root": home, "session": "run", "steps": 20000}
    arguments = [f"{name}:={value}" for name, value in {**values, "respawn": "true"}.items()]
    variables = environment(home)
    with launched(home, "learn.launch", *arguments, variables=variables) as process:
        run = Run(home, process, variables)
        run.wait_for(lambda: run.steps > 80)  # learning has begun
        yield run


@contextmanager
def frozen(process):
    os.kill(process, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(process, signal.SIGCONT)


def is_gone(process):
    return soak.sample(process) is None


def end(process, sig):
    """Send a signal and return the seconds until the process has ended, at most ten."""
    began = time.monotonic()
    os.kill(process, sig)
    while not is_gone(process) and time.monotonic() < began + 10.0:
        time.sleep(0.02)
    return time.monotonic() - began


def test_memory_handles_and_threads_do_not_grow(run):
    run.wait_for(lambda: run.last_update > 10 * CHECKPOINT_EVERY)  # later checkpoints reuse the memory of these
    tracks = {node: [] for node in NODES}
    processes = {node: run.pid(node) for node in NODES}
    for _ in range(SAMPLES):
        for node, track in tracks.items():
            item = soak.sample(processes[node])
            images = IMAGE * run.steps if node == "trainer" else 0.0
            track.append(soak.Sample(item.time, item.memory - images, item.descriptors, item.threads))
        time.sleep(PERIOD)
    assert not any(soak.growing(track, MEMORY) for track in tracks.values()), soak.table(tracks)


def test_run_continues_after_trainer_crash(run):
    former = run.pid("trainer")
    os.kill(former, signal.SIGKILL)
    run.wait_for_respawn("trainer", former)
    run.wait_for_progress()


def test_trainer_saves_checkpoint_while_master_hangs(run):
    trainer = run.pid("trainer")
    with frozen(run.pid("rosmaster")):
        assert end(trainer, signal.SIGTERM) < 10.0
        assert run.last_update == run.checkpoint.counters["updates"] > 0
    run.wait_for_respawn("trainer", trainer)
    run.wait_for_progress()


def test_planner_ends_while_trainer_hangs(run):
    planner = run.pid("ergodic_planner")
    with frozen(run.pid("trainer")):
        time.sleep(0.5)  # the planner waits for it by then
        assert end(planner, signal.SIGTERM) < 10.0
    assert run.arm_rests()
    run.wait_for_respawn("ergodic_planner", planner)
    run.wait_for_progress()


def test_planner_ends_while_arm_hangs(run):
    planner = run.pid("ergodic_planner")
    with frozen(run.pid("pybullet_arm")):
        time.sleep(0.5)
        assert end(planner, signal.SIGINT) < 10.0
    run.wait_for_respawn("ergodic_planner", planner)
    run.wait_for_progress()


def test_z_interrupted_run_leaves_checkpoint_and_no_processes(run):
    processes = {node: run.pid(node) for node in NODES}
    began = time.monotonic()
    run.process.send_signal(signal.SIGINT)
    while not all(map(is_gone, processes.values())):
        left = [node for node, process in processes.items() if not is_gone(process)]
        assert time.monotonic() < began + 5.0, f"{left} still running\n{run.output}"
        time.sleep(0.02)
    run.process.wait(30)
    assert "Traceback" not in run.output
    summary = read_summary(run.path / "summary.yaml")
    assert not summary.finished
    assert 0.0 < summary.wall_time < time.monotonic() - run.began_at
    assert run.last_update == run.checkpoint.counters["updates"] > 0
    assert len(Session.open_read_only(run.path).open_observations()) >= run.steps > 80
    # The session is unlocked and can be resumed.
    resolve_config("", {"session": {"root": str(run.path.parent), "name": "run", "resume": True}})
