"""Arm and camera on one computer, learning on another: network failure and restart of the robot's side."""

import time
from contextlib import ExitStack, contextmanager
from typing import Any, NamedTuple

import pytest
import yaml

from embodied_active_learning.session.session import Session
from hosts import ROBOT, SERVER, connected_hosts, why_not
from launching import ROOT, started
from real_time import stand_in, truth, with_franka_messages

pytestmark = pytest.mark.ros

REASON = why_not()
STEPS = 40
PROFILE = ROOT / "test" / "rostest" / "real_time.yaml"


class Side:
    """One computer: its folder, its environment, and the prefix of its commands."""

    def __init__(self, hosts, host, home):
        self.home = home / host
        self.home.mkdir()
        self.prefix = hosts.command(host)
        self.variables = with_franka_messages(hosts.environment(host, self.home))

    def launched(self, name, **arguments):
        words = [f"{key}:={value}" for key, value in arguments.items()]
        command = ["roslaunch", "--wait", "--sigint-timeout=10", "embodied_active_learning", name, *words]
        return started([*self.prefix, *map(str, command)], self.home / "launch.log", self.variables)

    def truth(self):
        """Return the true motion of the stand-in since the last call."""
        return truth(self.variables, self.prefix)

    @property
    def log(self):
        path = self.home / "launch.log"
        return path.read_text() if path.exists() else ""


class Run(NamedTuple):
    """A run on two computers and the process of the server's launch."""

    hosts: Any
    robot: Side
    server: Side
    learning: Any

    def wait_for(self, condition, what, timeout=120):
        """Wait for a condition; what: message of the failure."""
        ends_at = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < ends_at, f"{what}\n{self.robot.log}\n{self.server.log}"
            time.sleep(0.1)

    def arm(self, **arguments):
        """Run the robot's side during the block."""
        return self.robot.launched("robot.launch", bringup="nodes", profile=PROFILE, **arguments)

    @property
    def stored(self):
        table = self.server.home / "run" / "exploration.csv"
        return len(table.read_text().splitlines()) - 1 if table.exists() else 0

    def check_whole(self):
        """Check that each step was made exactly once."""
        assert "finished" in self.server.log, self.server.log
        session = Session.open_read_only(self.server.home / "run")
        assert session.read_table("exploration")["step"].tolist() == list(range(1, STEPS + 1))
        with session.open_observations() as store:
            assert len(store) == STEPS


@contextmanager
def begun(home):
    """Start a run that waits for its arm, on a master that was started before."""
    with connected_hosts() as hosts, ExitStack() as running:
        robot, server = (Side(hosts, host, home) for host in (ROBOT, SERVER))
        running.enter_context(started([*robot.prefix, "roscore"], robot.home / "core.log", robot.variables))
        running.enter_context(stand_in(robot.home, robot.variables, f"profile:={PROFILE}", prefix=robot.prefix))
        arguments = {"robot": "franka", "bringup": "none", "profile": PROFILE, "steps": STEPS, "session": "run"}
        learning = server.launched("learn.launch", session_root=server.home, **arguments)
        yield Run(hosts, robot, server, running.enter_context(learning))


@pytest.mark.skipif(bool(REASON), reason=REASON)
def test_arm_stops_without_network_and_run_resumes(tmp_path):
    with begun(tmp_path) as run, run.arm():
        robot = run.robot
        run.wait_for(lambda: run.stored >= 10, "the run did not start")
        run.hosts.pull_cable()
        run.wait_for(lambda: "the arm is stopped and free for other nodes" in robot.log, "the arm was not freed")
        assert robot.truth()["speed"] < 0.001
        before = run.stored
        time.sleep(1.0)
        assert run.stored == before, "something was stored without an arm"
        assert robot.truth()["travelled"] < 0.001
        run.hosts.plug_cable()
        run.learning.wait(180)
        truth = robot.truth()
    assert "waiting for a response of /arm/" in run.server.log
    assert truth["max_outside"] < 0.003
    run.check_whole()


@pytest.mark.skipif(bool(REASON), reason=REASON)
def test_restarted_arm_rejects_commands_on_config_mismatch(tmp_path):
    lab = yaml.safe_load((ROOT / "config" / "franka.yaml").read_text())
    other = tmp_path / "other.yaml"
    other.write_text(yaml.safe_dump({**lab, "workspace": {**lab["workspace"], "x": [0.35, 0.6]}}))
    with begun(tmp_path) as run:
        with run.arm():
            run.wait_for(lambda: run.stored >= 10, "the run did not start")
        with run.arm(robot_profile=other):
            run.wait_for(
                lambda: "rejecting commands: configuration mismatch: workspace/x" in run.robot.log,
                "commands were accepted",
            )
            before = run.stored
            run.robot.truth()
            run.wait_for(
                lambda: "arm held still: configuration mismatch: workspace/x" in run.server.log,
                "no command was sent",
            )
            assert run.stored == before, "something was stored with the wrong arm"
            assert run.robot.truth()["travelled"] < 0.001
        with run.arm():
            run.learning.wait(180)
    run.check_whole()
