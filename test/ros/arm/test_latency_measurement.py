"""Measurement of the camera's latency, with an arm that turns as commanded; no ROS master."""

import subprocess
import sys
import threading

import numpy as np
import pytest
import rospy

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ArmBusyError, NoResponseError
from embodied_active_learning.ros.arm import latency_measurement
from embodied_active_learning.ros.arm.client import ArmClient
from embodied_active_learning.ros.arm.latency_measurement import LatencyRecorder, measure_latency
from embodied_active_learning.ros.conversions import image_message, state_message
from launching import ROOT

RATE = 30  # images and states per second


class Recorder(LatencyRecorder):
    """Measures the rotation of an image from its brightest pixel's column: one column is a hundredth of a radian."""

    def __init__(self, config):
        super().__init__(config)
        self._tracker = self

    def rotation(self, image):
        return (image[0, :, 0].argmax() - 90) / 100.0


class Arm:
    """Turns without delay, and sends its states and images to the recorder."""

    stop_if_commander = ArmClient.stop_if_commander

    def __init__(self):
        self.calls = []
        self._stop_lock = threading.Lock()
        self.moves_until_failure = 10**4
        self.is_commander = True
        self.time = 0.0
        self.yaw = 0.0
        self.repetitions = 1
        self.recorder = None

    def go_to(self, pose):
        self.calls.append("go_to")

    def move(self, velocity, duration):
        self.calls.append("move")
        if self.calls.count("move") > self.moves_until_failure:
            raise ArmBusyError("commanded by /ergodic_planner")
        for _ in range(round(duration * RATE)):
            self.time += 1.0 / RATE
            self.yaw += velocity[2] / RATE
            self.publish(rospy.Time.from_sec(self.time))

    def publish(self, stamp):
        image = np.zeros((180, 180, 3), np.uint8)
        image[0, 90 + round(100 * self.yaw)] = 255
        for _ in range(self.repetitions):
            self.recorder.add_state(state_message(stamp, (0.5, 0.0, self.yaw), np.zeros(3)))
            self.recorder.add_image(image_message(stamp, image))

    def heartbeat(self):
        return self.is_commander

    def stop(self):
        self.calls.append("stop")


class Lease:
    """A lease that does not expire."""

    def __init__(self, timeout, heartbeat):
        self.is_held, self.held = False, []

    def renew(self):
        self.is_held = True

    def end(self):
        self.is_held = False


@pytest.fixture
def arm(monkeypatch):
    arm = Arm()

    def make_recorder(config):
        arm.recorder = Recorder(config)
        return arm.recorder

    monkeypatch.setattr(latency_measurement, "LatencyRecorder", make_recorder)
    monkeypatch.setattr(latency_measurement, "wall_sleep", lambda seconds: None)
    monkeypatch.setattr(latency_measurement.rospy, "Subscriber", lambda *arguments, **options: None)
    return arm


def test_camera_without_latency(arm):
    assert measure_latency(arm, Config()).latency == pytest.approx(0.0, abs=0.01)
    assert set(arm.calls[1:-1]) == {"move"}
    assert (arm.calls[0], arm.calls[-1]) == ("go_to", "stop")


def test_arm_is_stopped_if_a_command_fails(arm):
    arm.moves_until_failure = 3
    with pytest.raises(ArmBusyError, match="commanded by /ergodic_planner"):
        measure_latency(arm, Config())
    assert arm.calls[-1] == "stop"


def test_arm_of_another_commander_is_not_stopped(arm):
    """Its stop would be an emergency stop, after which a person has to recover the arm."""
    arm.moves_until_failure, arm.is_commander = 0, False
    with pytest.raises(ArmBusyError):
        measure_latency(arm, Config())
    assert "stop" not in arm.calls


def test_unconfirmed_stop_keeps_first_error(arm):
    def fail():
        raise NoResponseError("gone")

    arm.moves_until_failure, arm.heartbeat, arm.stop = 0, fail, fail
    with pytest.raises(ArmBusyError):
        measure_latency(arm, Config())


def test_control_is_kept_until_the_rotation_begins(arm, monkeypatch):
    """Also with an arm/commander_timeout below the delay."""
    leases = []
    monkeypatch.setattr(latency_measurement, "Lease", lambda *arguments: leases.append(Lease(*arguments)) or leases[0])
    monkeypatch.setattr(latency_measurement, "wall_sleep", lambda seconds: leases[0].held.append(leases[0].is_held))
    measure_latency(arm, Config())
    assert leases[0].held == [True, False]


def test_repeated_messages_are_skipped(arm):
    once = measure_latency(arm, Config())
    arm.repetitions, arm.time, arm.yaw = 3, 0.0, 0.0
    assert measure_latency(arm, Config()) == once


def test_failed_measurement_does_not_end_a_run():
    program = f"""
import runpy
from embodied_active_learning.ros.runtime import node
node.run_node = lambda name, body, **options: print(name, options)
runpy.run_path({str(ROOT / "nodes" / "measure_latency")!r}, run_name="__main__")
"""
    ended = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    assert (
        ended.stdout.strip()
        == "measure_latency {'needs_clock': True, 'reads_arm_config': True, 'failure_ends_run': False}"
    )
