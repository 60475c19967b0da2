"""The stand-in for franka_ros: robot, franka_control, controllers and camera, and faults for tests."""

from __future__ import annotations

import json
import math
import time
from dataclasses import fields
from typing import Any, Callable

import numpy as np
import rospy
from std_srvs.srv import SetBool, SetBoolResponse, Trigger, TriggerResponse

from embodied_active_learning.config import Config
from fake_franka.computer import Computer, Every
from fake_franka.frames import Frames, pose_of
from fake_franka.franka_control import FrankaControl
from fake_franka.manager_services import ManagerServices
from fake_franka.robot import Behaviour, FakeRobot
from fake_franka.state_controller import StateController
from fake_franka.usb_cam import FakeUsbCam

MOTION_RATE = 200.0
"""Updates of the motion per second; the motion itself is calculated in milliseconds."""


class StandIn:
    """Everything on the robot's computer, as one node."""

    def __init__(self, config: Config) -> None:
        self._computer = Computer()
        self._frames = Frames(config)
        start = self._frames.ee_with_camera_at(*rospy.get_param("~start", config.workspace.box().centre.tolist()))
        given = {one.name: rospy.get_param(f"~{one.name}", one.default) for one in fields(Behaviour)}
        position, orientation = pose_of(start)
        self._robot = FakeRobot(
            time.monotonic, position, orientation, Behaviour(**given), self._frames.outside, rospy.logerr
        )
        self._states = StateController(self._robot, self._frames)
        self._are_silent = False
        self._camera = (
            FakeUsbCam(self._camera_pose, config, self._computer) if rospy.get_param("~camera", True) else None
        )
        self._manager = ManagerServices(self._robot, self._computer)
        FrankaControl(self._robot, self._frames, self._computer)
        self._offer_faults()
        Every(lambda: MOTION_RATE, self._robot.advance)
        Every(lambda: self._manager.state_rate, self._publish_states)

    def _camera_pose(self) -> np.ndarray:
        self._robot.advance()
        with self._robot.lock:
            return self._frames.camera(self._robot.hand.position, self._robot.hand.orientation)

    def _publish_states(self) -> None:
        if not self._are_silent and self._computer.is_alive and self._manager.publishes_states:
            self._states.publish()

    def _offer_faults(self) -> None:
        robot = self._robot
        _trigger("reflex", lambda: robot.reflex("cartesian_reflex"))
        _trigger("fail_next_recovery", robot.fail_next_recovery)
        _trigger("restart_franka_control", self._restart_control)
        _trigger("truth", self._truth_text)
        _switch("user_stop", robot.set_user_stop)
        _switch("silence_states", lambda on: setattr(self, "_are_silent", on))
        _switch("silence_everything", self._silence)
        _switch("hang_controller_manager", self._manager.hang)
        if self._camera is not None:
            _switch("freeze_camera", lambda on: setattr(self._camera, "is_frozen", on))
            _switch("silence_camera", lambda on: setattr(self._camera, "is_silent", on))

    def _restart_control(self) -> None:
        self._robot.restart_control()
        self._manager.restart()

    def _silence(self, on: bool) -> None:
        """Silence the computer, after which the robot stops the arm, or revive it."""
        if on:
            self._computer.die()
            self._robot.lose_contact()
        else:
            self._computer.revive()

    def _truth_text(self) -> str:
        """Return the true motion since the last call and the camera's true pose as JSON."""
        camera = self._camera_pose()
        truth = self._robot.take_truth()
        truth["pose"] = [camera[0, 3], camera[1, 3], math.atan2(camera[1, 0], camera[0, 0])]
        truth["speed"] = self._robot.hand.speed
        truth["stiffness"] = self._robot.hand.requested_stiffness
        truth["load"] = self._frames.load[0]
        truth["mode"] = self._robot.mode
        return json.dumps(truth)


def _trigger(name: str, action: Callable[[], Any]) -> None:
    rospy.Service(f"~{name}", Trigger, lambda _request: TriggerResponse(True, str(action() or "")))


def _switch(name: str, action: Callable[[bool], None]) -> None:
    def answer(request: Any) -> SetBoolResponse:
        action(request.data)
        return SetBoolResponse(True, "")

    rospy.Service(f"~{name}", SetBool, answer)


def main(config: Config) -> None:
    """Run the stand-in until the node ends."""
    StandIn(config)
    rospy.loginfo("the stand-in for franka_ros is ready: no robot is connected")
    rospy.spin()
