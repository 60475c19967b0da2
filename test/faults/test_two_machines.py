"""Arm and camera on one computer, learning on another, and the cable between them is pulled."""

import time
from contextlib import ExitStack

import pytest

from embodied_active_learning.session.session import Session
from launching import ROOT, started
from real_time import stand_in, truth, with_franka_messages
from two_hosts import ROBOT, SERVER, two_hosts, why_not

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

    @property
    def said(self):
        path = self.home / "launch.log"
        return path.read_text() if path.exists() else ""


def stored(path):
    table = path / "exploration.csv"
    return len(table.read_text().splitlines()) - 1 if table.exists() else 0


@pytest.mark.skipif(bool(REASON), reason=REASON)
def test_the_arm_stops_when_the_cable_is_pulled_and_the_run_goes_on_when_it_is_back(tmp_path):
    path = tmp_path / SERVER / "run"
    with two_hosts() as hosts, ExitStack() as running:
        robot, server = (Side(hosts, host, tmp_path) for host in (ROBOT, SERVER))

        def wait_for(condition, what, timeout=120):
            ends_at = time.monotonic() + timeout
            while not condition():
                assert time.monotonic() < ends_at, f"{what}\n{robot.said}\n{server.said}"
                time.sleep(0.1)

        running.enter_context(
            started([*robot.prefix, "roscore"], robot.home / "core.log", robot.variables),
        )
        running.enter_context(stand_in(robot.home, robot.variables, f"profile:={PROFILE}", prefix=robot.prefix))
        running.enter_context(robot.launched("robot.launch", bringup="nodes", profile=PROFILE))
        # Both put up a configuration; that of the run has to be the later one.
        wait_for(lambda: "process[franka_arm" in robot.said, "the robot's side did not begin")
        learning = running.enter_context(
            server.launched(
                "learn.launch",
                robot="franka",
                bringup="none",
                profile=PROFILE,
                steps=STEPS,
                session="run",
                session_root=tmp_path / SERVER,
            )
        )
        wait_for(lambda: stored(path) >= 10, "it did not begin")
        hosts.pull_cable()
        wait_for(lambda: "gives no sign of life any more: the arm is stopped" in robot.said, "the arm was not freed")
        assert truth(robot.variables, robot.prefix)["speed"] < 0.001
        before = stored(path)
        time.sleep(1.0)
        assert stored(path) == before, "something was stored without an arm"
        assert truth(robot.variables, robot.prefix)["travelled"] < 0.001
        hosts.plug_cable()
        learning.wait(180)
        told = truth(robot.variables, robot.prefix)
    assert "finished" in server.said, server.said
    assert "waiting for the ROS master" in server.said
    assert told["max_outside"] < 0.003
    session = Session.open_read_only(path)
    assert session.read_table("exploration")["step"].tolist() == list(range(1, STEPS + 1))
    with session.open_observations() as store:
        assert len(store) == STEPS
