#!/usr/bin/env python3
"""Simulates the paper's velocity service on a Panda, and usb_cam: the same services and topics, in real time.

Private parameters as of fake_franka_node.py: world, camera, framerate, encoding, image_width, image_height. Services:
fake_velocity_service/stop_robot, silence_poses, hang (SetBool) and truth (Trigger, JSON).
"""

import embodied_active_learning.ros.runtime.startup  # noqa: F401  before the slow imports

import json
import os
import sys
import threading
import time
from pathlib import Path

import numpy as np
import rospy
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from std_msgs.msg import Header
from std_srvs.srv import SetBool, SetBoolResponse, Trigger, TriggerResponse

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from embodied_active_learning.srv import (
    StartVelocityControl,
    StartVelocityControlResponse,
    UpdateVelocity,
    UpdateVelocityResponse,
)

from embodied_active_learning.franka.mount import CameraMount, CameraPose
from embodied_active_learning.geometry import quaternion
from embodied_active_learning.ros import names
from embodied_active_learning.ros.runtime.node import run_node
from fake_franka.computer import Computer, Every
from fake_franka.usb_cam import FakeUsbCam
from fake_velocity_service.robot import VelocityRobot

STEP = 0.2  # s, /dt
RATE = 100.0  # Hz of the poses


class FakeVelocityService:
    """Offers the services and publishes the poses."""

    def __init__(self, config):
        self._mount = CameraMount.from_config(config)
        self._lock = threading.Lock()
        self._advanced_at = time.monotonic()
        self._is_silent = False
        self._responds = threading.Event()  # whether the velocity service does
        self._responds.set()
        matrix = np.eye(4)
        pose = CameraPose(tuple(map(float, config.workspace.box().centre)), 0.0, (0.0, 0.0))
        matrix[:3, 3], matrix[:3, :3] = self._mount.end_effector(pose)
        self._robot = VelocityRobot(matrix, STEP)
        rospy.set_param(names.VELOCITY_STEP, STEP)
        self._poses = rospy.Publisher(names.END_EFFECTOR_POSE, PoseStamped, queue_size=1)
        rospy.Service(names.VELOCITY_COMMAND, UpdateVelocity, self._command)
        rospy.Service(names.VELOCITY_START, StartVelocityControl, self._start)
        rospy.Service("fake_velocity_service/stop_robot", SetBool, self._stop_robot)
        rospy.Service("fake_velocity_service/silence_poses", SetBool, self._silence)
        rospy.Service("fake_velocity_service/hang", SetBool, self._hang)
        rospy.Service("fake_velocity_service/truth", Trigger, self._truth)
        Every(lambda: RATE, self._publish)

    def camera(self):
        """Return the pose (4, 4) of the camera's optical frame."""
        pose, camera = self._pose(), np.eye(4)
        camera[:3, :3] = pose[:3, :3] @ self._mount.rotation
        camera[:3, 3] = pose[:3, 3] + pose[:3, :3] @ self._mount.position
        return camera

    def _pose(self):
        with self._lock:
            now = time.monotonic()
            self._robot.advance(now - self._advanced_at)
            self._advanced_at = now
            return self._robot.pose.copy()

    def _publish(self):
        message = PoseStamped(Header(stamp=rospy.Time.now(), frame_id=names.FRAMES.base), _message(self._pose()))
        if not self._is_silent:
            self._poses.publish(message)

    def _command(self, request):
        self._responds.wait()
        pose, twist = self._pose(), request.desired_vel
        linear, angular = ([one.x, one.y, one.z] for one in (twist.linear, twist.angular))
        with self._lock:
            return UpdateVelocityResponse(_message(pose), self._robot.command(linear, angular))

    def _start(self, _request):
        pose = self._pose()
        with self._lock:
            return StartVelocityControlResponse(_message(pose), self._robot.start())

    def _stop_robot(self, request):
        self._robot.success = not request.data
        return SetBoolResponse(True, "")

    def _silence(self, request):
        self._is_silent = request.data
        return SetBoolResponse(True, "")

    def _hang(self, request):
        (self._responds.clear if request.data else self._responds.set)()
        return SetBoolResponse(True, "")

    def _truth(self, _request):
        self._pose()
        camera, robot = self._mount.camera_pose(self._robot.pose.T.ravel()), self._robot
        truth = {
            "camera": camera.planar,
            "height_error": camera.height,
            "speed": float(np.abs(robot.velocity).max()),
            "largest": robot.largest.tolist(),
            "process": os.getpid(),
            "starts": robot.starts,
            "starts_in_motion": robot.starts_in_motion,
            "requests": robot.requests,
        }
        return TriggerResponse(True, json.dumps(truth))


def _message(matrix):
    return Pose(Point(*matrix[:3, 3].tolist()), Quaternion(*quaternion(matrix[:3, :3])))


def main(config):
    """Serve until the node ends."""
    service = FakeVelocityService(config)
    if rospy.get_param("~camera", True):
        FakeUsbCam(service.camera, config, Computer())
    rospy.spin()


if __name__ == "__main__":
    run_node("fake_velocity_service", main)
