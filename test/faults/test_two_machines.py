"""Arm and camera on one computer, learning on another; the cable is pulled, and the robot's side started anew."""

import time
from contextlib import ExitStack, contextmanager
from typing import Any, NamedTuple

import pytest
import yaml

from embodied_active_learning.session.session import Session
from launching import ROOT, started
from real_time import stand_in, truth, with_franka_messages
from two_hosts import ROBOT, SERVER, two_hosts, why_not

pytestmark = pytest.mark.ros

REASON = why_not()
STEPS = 40
PROFILE = ROOT / "test" / "rostest" / "real_time.yaml"


class Side:
    """One computer: its folder, its variables, and what starts a command there."""

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
        """What the stand-in's arm did since this was asked last."""
        return truth(self.variables, self.prefix)

    @property
    def said(self):
        path = self.home / "launch.log"
        return path.read_text() if path.exists() else ""


class Run(NamedTuple):
    """A run of two sides: the cable's hosts, both sides, and the process of the server's."""

    hosts: Any
    robot: Side
    server: Side
    learning: Any

    def wait_for(self, condition, what, timeout=120):
        """Return when a condition holds; what: it tells when it does not."""
        ends_at = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < ends_at, f"{what}\n{self.robot.said}\n{self.server.said}"
            time.sleep(0.1)

    def arm(self, **arguments):
        """The robot's side, while the block lasts."""
        return self.robot.launched("robot.launch", bringup="nodes", profile=PROFILE, **arguments)

    @property
    def stored(self):
        table = self.server.home / "run" / "exploration.csv"
        return len(table.read_text().splitlines()) - 1 if table.exists() else 0

    def check_whole(self):
        """All steps were made, and each once."""
        assert "finished" in self.server.said, self.server.said
        session = Session.open_read_only(self.server.home / "run")
        assert session.read_table("exploration")["step"].tolist() == list(range(1, STEPS + 1))
        with session.open_observations() as store:
            assert len(store) == STEPS


@contextmanager
def begun(home):
    """A run that waits for its arm, on a master that is older than both sides."""
    with two_hosts() as hosts, ExitStack() as running:
        robot, server = (Side(hosts, host, home) for host in (ROBOT, SERVER))
        running.enter_context(started([*robot.prefix, "roscore"], robot.home / "core.log", robot.variables))
        running.enter_context(stand_in(robot.home, robot.variables, f"profile:={PROFILE}", prefix=robot.prefix))
        arguments = {"robot": "franka", "bringup": "none", "profile": PROFILE, "steps": STEPS, "session": "run"}
        learning = server.launched("learn.launch", session_root=server.home, **arguments)
        yield Run(hosts, robot, server, running.enter_context(learning))


@pytest.mark.skipif(bool(REASON), reason=REASON)
def test_the_arm_stops_when_the_cable_is_pulled_and_the_run_goes_on_when_it_is_back(tmp_path):
    with begun(tmp_path) as run, run.arm():
        robot = run.robot
        run.wait_for(lambda: run.stored >= 10, "it did not begin")
        run.hosts.pull_cable()
        run.wait_for(lambda: "the arm is stopped and free for other nodes" in robot.said, "it was not freed")
        assert robot.truth()["speed"] < 0.001
        before = run.stored
        time.sleep(1.0)
        assert run.stored == before, "something was stored without an arm"
        assert robot.truth()["travelled"] < 0.001
        run.hosts.plug_cable()
        run.learning.wait(180)
        told = robot.truth()
    assert "waiting for a response of /arm/" in run.server.said
    assert told["max_outside"] < 0.003
    run.check_whole()


@pytest.mark.skipif(bool(REASON), reason=REASON)
def test_the_robots_side_may_be_started_anew_and_an_arm_with_other_limits_takes_no_command(tmp_path):
    lab = yaml.safe_load((ROOT / "config" / "franka.yaml").read_text())
    other = tmp_path / "other.yaml"
    other.write_text(yaml.safe_dump({**lab, "workspace": {**lab["workspace"], "x": [0.35, 0.6]}}))
    with begun(tmp_path) as run:
        with run.arm():
            run.wait_for(lambda: run.stored >= 10, "it did not begin")
        with run.arm(robot_profile=other):
            run.wait_for(
                lambda: "refusing commands: configuration mismatch: workspace/x" in run.robot.said, "it was let"
            )
            before = run.stored
            run.robot.truth()
            run.wait_for(
                lambda: "arm held still: configuration mismatch: workspace/x" in run.server.said,
                "nobody tried to drive it",
            )
            assert run.stored == before, "something was stored with the wrong arm"
            assert run.robot.truth()["travelled"] < 0.001
        with run.arm():
            run.learning.wait(180)
    run.check_whole()
