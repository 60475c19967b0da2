"""Driver and stand-in in a closed loop, in simulated time: what the lab profile's limits give under the real law."""

import math

import numpy as np
import pytest

from driver_lab import DriverLab, Stop
from embodied_active_learning.config import Config, load_profile
from embodied_active_learning.franka.mount import CameraMount, CameraPose
from embodied_active_learning.franka.report import CONTROLLER, Controller, RobotMode
from embodied_active_learning.franka.set_point_driver import SetPointDriver
from fake_franka.frames import matrix_of, pose_of
from fake_franka.robot import Behaviour, FakeRobot
from launching import ROOT

PROFILE = {**load_profile(ROOT / "config" / "franka.yaml")}
PROFILE["arm"] = {**PROFILE["arm"], "robot": "franka", "max_duration": 10.0}
LAB = Config.from_dict(PROFILE)
STATE_PERIOD = 1.0 / 30.0


class Loop(DriverLab):
    """A driver that sends set-points at 100 Hz and receives states at 30 Hz of a FakeRobot."""

    def __init__(self, config=LAB, friction=0.0):
        super().__init__(lambda clock: SetPointDriver(config, clock))
        self._mount = CameraMount.from_config(config)
        position, rotation = self._mount.end_effector(CameraPose(tuple(config.workspace.box().centre), 0.0, (0.0, 0.0)))
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = rotation, position
        self.robot = FakeRobot(lambda: self.now, *pose_of(matrix), Behaviour(friction=friction))
        self.robot.hand.set_stiffness(config.franka.stiffness, config.franka.turn_stiffness)
        self.robot.change_controllers(moves_the_arm=True, impedance=True)
        self.now += 3.0
        self.robot.advance()
        self._state_at = self.now
        self.rates = []
        self.passes(0.2)

    def tick_robot(self):
        self.robot.advance()
        if self.now >= self._state_at:
            self._state_at += STATE_PERIOD
            hand = self.robot.hand
            pose = matrix_of(hand.position, hand.orientation).T.ravel()
            self.driver.update_state(self.now, 0.0, pose, RobotMode.MOVE, (), ())
        self.driver.update_control(controllers={CONTROLLER: Controller("running", True)})
        set_point = self.driver.tick()
        if set_point is not None:
            matrix = np.eye(4)
            matrix[:3, 3], matrix[:3, :3] = self._mount.end_effector(set_point)
            self.robot.take_set_point(*pose_of(matrix))
        self.rates.append(self.robot.hand.turning[2])


def test_lab_profile_reaches_its_turn_rate():
    loop = Loop()
    loop.runs(loop.driver.go_to, (0.475, 0.0, -1.9), Stop())
    loop.runs(loop.driver.move, (0.0, 0.0, LAB.arm.max_turn_rate), 6.0, Stop())
    assert max(loop.rates) == pytest.approx(LAB.arm.max_turn_rate, rel=0.02)
    assert not loop.robot.errors


def test_turn_rate_is_limited_by_lead_at_lower_stiffness():
    """At 20 Nm/rad and a lead of 0.5 rad, 0.6 rad/s cannot be reached; the set-point stays within its lead."""
    profile = {**PROFILE, "arm": {**PROFILE["arm"], "max_turn_rate": 0.6}}
    loop = Loop(Config.from_dict({**profile, "franka": {**PROFILE["franka"], "turn_stiffness": 20.0}}))
    loop.runs(loop.driver.go_to, (0.475, 0.0, -1.9), Stop())
    loop.rates.clear()
    loop.runs(loop.driver.move, (0.0, 0.0, 0.6), 6.0, Stop())
    assert 0.38 < max(loop.rates) < 0.45
    assert not loop.robot.errors


def test_go_to_turns_by_1_9_rad_and_stops_within_tolerance():
    loop = Loop(friction=1.0)
    began_at = loop.now
    reached = loop.runs(loop.driver.go_to, (0.55, 0.1, 1.9), Stop())
    assert loop.now - began_at < 7.5
    assert math.hypot(reached.pose[0] - 0.55, reached.pose[1] - 0.1) <= LAB.franka.tolerance
    assert abs(reached.pose[2] - 1.9) <= LAB.franka.turn_tolerance


def test_arm_stays_in_workspace_up_to_its_overshoot():
    """The damping is not critical for the hand's mass, so the arm overshoots the set-point slightly."""
    loop = Loop()
    loop.runs(loop.driver.move, (0.1, 0.1, 0.0), 4.0, Stop())
    loop.passes(2.0)
    x, y, _ = loop.robot.hand.position
    upper = LAB.workspace.box().upper
    assert x <= upper[0] + 0.003
    assert y <= upper[1] + 0.003
