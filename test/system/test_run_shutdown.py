"""Nodes of a run are ended while others are frozen: they save their state, resume, and leave no processes."""

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest
import yaml

from embodied_active_learning.pipeline.resolve import resolve_config
from embodied_active_learning.session.checkpoints import load_latest
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.summary import read_summary
from launching import ROOT, Run, environment, frozen, launched

pytestmark = pytest.mark.ros

TINY = ROOT / "test" / "rostest" / "tiny.yaml"
NODES = ("pybullet_arm", "trainer", "ergodic_planner", "fingerprinter", "monitor")
CHECKPOINT_EVERY = 60  # updates
LIMIT = 30.0
"""s within which a node ends: the trainer's own limit (8 s), on a busy machine."""


class RespawnedRun(Run):
    """A learning run with respawn:=true."""

    @property
    def last_update(self):
        return Session.open_read_only(self.path).read_table("training")["update"][-1]

    @property
    def checkpoint(self):
        return load_latest(self.path / "checkpoints")

    def arm_rests(self):
        command = ["rostopic", "echo", "-n1", "/arm/state"]
        response = subprocess.run(command, env=self.variables, capture_output=True, text=True, timeout=30, check=True)
        state = next(yaml.safe_load_all(response.stdout))
        return max(abs(state[key]) for key in ("vx", "vy", "omega")) < 1e-4

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
        run, began_at = RespawnedRun(home, "run", process, variables), time.monotonic()
        run.wait_for(lambda: run.steps > 80)  # learning has begun
        yield run
        if process.poll() is None:
            check_interrupt(run, began_at)


def is_gone(process):
    """Return whether a process has ended."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except OSError:
        return True


def end(process, sig):
    """Send a signal and return the seconds until the process has ended, at most LIMIT."""
    began = time.monotonic()
    os.kill(process, sig)
    while not is_gone(process) and time.monotonic() < began + LIMIT:
        time.sleep(0.02)
    return time.monotonic() - began


def test_trainer_saves_checkpoint_while_master_hangs(run):
    trainer = run.pid("trainer")
    with frozen(run.pid("rosmaster")):
        assert end(trainer, signal.SIGTERM) < LIMIT
        assert run.last_update == run.checkpoint.counters["updates"] > 0
    run.wait_for_respawn("trainer", trainer)
    run.wait_for_progress()


def test_planner_ends_while_trainer_hangs(run):
    planner = run.pid("ergodic_planner")
    with frozen(run.pid("trainer")):
        time.sleep(0.5)  # the planner waits for it by then
        assert end(planner, signal.SIGTERM) < LIMIT
        run.wait_for(run.arm_rests)
    run.wait_for_respawn("ergodic_planner", planner)
    run.wait_for_progress()


def test_planner_ends_while_arm_hangs(run):
    planner = run.pid("ergodic_planner")
    with frozen(run.pid("pybullet_arm")):
        time.sleep(0.5)
        assert end(planner, signal.SIGINT) < LIMIT
    run.wait_for_respawn("ergodic_planner", planner)
    run.wait_for_progress()


def check_interrupt(run, began_at):
    """Interrupt a run, and check that it leaves a checkpoint and no processes."""
    processes = {node: run.pid(node) for node in NODES}
    before, began = len(run.log), time.monotonic()
    run.process.send_signal(signal.SIGINT)
    while not all(map(is_gone, processes.values())):
        left = [node for node, process in processes.items() if not is_gone(process)]
        assert time.monotonic() < began + LIMIT, f"{left} still running\n{run.log}"
        time.sleep(0.02)
    run.process.wait(30)
    assert "Traceback" not in run.log
    for words in ("shutdown timeout", "escalating"):
        assert words not in run.log[before:], run.log
    summary = read_summary(run.path / "summary.yaml")
    assert not summary.finished
    assert 0.0 < summary.wall_time < time.monotonic() - began_at
    assert run.last_update == run.checkpoint.counters["updates"] > 0
    assert len(Session.open_read_only(run.path).open_observations()) >= run.steps > 80
    # The session is unlocked and can be resumed.
    resolve_config("", {"session": {"root": str(run.path.parent), "name": "run", "resume": True}})
