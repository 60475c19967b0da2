"""Driver, sender and a stand-in for the velocity service in a closed loop, on a clock that the tests advance."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from driver_lab import TICK, DriverLab, Stop
from embodied_active_learning.config import Config
from embodied_active_learning.errors import ArmFailedError, ArmStoppedError
from embodied_active_learning.franka.mount import CameraMount, CameraPose
from embodied_active_learning.franka.report import Condition, RobotMode
from embodied_active_learning.franka.set_points import MAX_PERIOD, Tracking
from embodied_active_learning.franka.velocity_tracking import VelocityTracker, velocity_driver
from embodied_active_learning.ros.arm.velocity_sender import VelocitySender
from fake_velocity_service.robot import VelocityRobot

CONFIG = Config.from_dict(
    {
        "arm": {"robot": "velocity_service", "max_speed": 0.1, "max_turn_rate": 0.7},
        "franka": {"camera_position": (0.05, 0.0, 0.04), "camera_rotation": (0.0, 0.0, 0.7)},
    }
)
ARM = CONFIG.arm
# of x, y, theta, height and tilt
TOP = np.array([ARM.max_speed, ARM.max_speed, ARM.max_turn_rate, 0.02, 0.1, 0.1])
ACCELERATION = np.array([ARM.max_acceleration, ARM.max_acceleration, ARM.max_turn_acceleration, 0.1, 0.5, 0.5])
ROUNDING = 1e-9
CENTRE = tuple(map(float, CONFIG.workspace.box().centre))


class Lab(DriverLab):
    """A robot whose pose arrives with a delay of five ticks."""

    def __init__(self, pose=CENTRE, height=0.0, **robot):
        super().__init__(lambda clock: velocity_driver(CONFIG, clock))
        self.mount = CameraMount.from_config(CONFIG)
        matrix = np.eye(4)
        matrix[:3, 3], matrix[:3, :3] = self.mount.end_effector(CameraPose(pose, height, (0.0, 0.0)))
        self.robot = VelocityRobot(matrix, **robot)
        self.readiness = self.driver._readiness
        interface = SimpleNamespace(send=lambda twist: self.robot.command(*twist))
        self.sender = VelocitySender(interface, self.driver, CONFIG, lambda: self.now)
        self.cameras, self.queue = [], []
        self.passes(0.3)

    @property
    def camera(self):
        return self.mount.camera_pose(self.robot.pose.T.ravel())

    def tick_robot(self):
        self.robot.advance(TICK)
        self.cameras.append(self.camera)
        self.queue.append((self.now, self.robot.pose.T.ravel().copy()))
        if len(self.queue) > 5:
            stamp, pose = self.queue.pop(0)
            self.driver.update_state(stamp, self.now - stamp, pose, RobotMode.OTHER)
        self.sender.send()


def test_go_to_arrives_within_limits_although_poses_are_late():
    lab = Lab()
    reached = lab.runs(lab.driver.go_to, (0.6, 0.12, 1.0), Stop())
    lab.passes(0.5)
    np.testing.assert_allclose(lab.camera.planar, (0.6, 0.12, 1.0), atol=5e-3)
    np.testing.assert_allclose(reached.pose, (0.6, 0.12, 1.0), atol=CONFIG.franka.tolerance)
    speeds = np.diff([camera.planar for camera in lab.cameras], axis=0) / TICK
    assert np.all(np.abs(speeds).max(axis=0) <= np.array([0.1, 0.1, 0.7]) * 1.05)


def test_height_is_held_against_drift():
    lab = Lab(height=0.01, drift=(0.0, 0.0, 0.004))
    lab.runs(lab.driver.go_to, (0.5, 0.1, 0.0), Stop())
    lab.runs(lab.driver.go_to, (0.5, -0.1, 0.0), Stop())
    assert abs(lab.camera.height) < 4e-3
    assert lab.camera.tilt_angle < 0.01


def test_camera_turns_about_itself_with_offset_mount():
    lab = Lab()
    lab.runs(lab.driver.go_to, (*CENTRE[:2], 1.5), Stop())
    path = np.array([camera.planar[:2] for camera in lab.cameras])
    assert np.abs(path - CENTRE[:2]).max() < 5e-3


def test_workspace_is_kept_when_driven_at_its_border():
    lab = Lab(pose=(0.58, 0.0, 0.0))
    for _ in range(8):
        assert lab.runs(lab.driver.move, (0.1, 0.0, 0.0), 0.2, Stop()) is not None
    assert max(camera.planar[0] for camera in lab.cameras) <= CONFIG.workspace.x[1] + 5e-3
    assert lab.camera.planar[0] > CONFIG.workspace.x[1] - 0.01


def test_stop_ends_motion_within_braking_distance():
    lab, stop = Lab(), Stop()
    outcome = lab.begins(lab.driver.move, (0.1, 0.0, 0.0), 1.0, stop)
    lab.passes(0.5)
    stop.now, at = True, lab.camera.planar[0]
    outcome.thread.join(10.0)
    lab.passes(1.0)
    assert isinstance(outcome.error, ArmStoppedError)
    assert lab.camera.planar[0] - at < 0.03
    assert np.abs(lab.robot.velocity).max() < 1e-3


def test_robot_that_does_not_follow_is_held_until_released():
    lab = Lab()
    outcome = lab.begins(lab.driver.move, (0.1, 0.0, 0.0), 1.0, Stop())
    lab.passes(0.2)
    lab.robot.success = False
    lab.passes(0.2)
    outcome.thread.join(10.0)
    assert isinstance(outcome.error, ArmStoppedError)
    lab.robot.success = True
    lab.passes(3.0)
    assert lab.readiness.condition is Condition.RECOVERY_REQUIRED
    assert "/arm/recover" in lab.driver.why_not_ready()
    lab.driver.update_control(errors=())
    lab.readiness.release()
    lab.passes(0.1)
    assert lab.readiness.is_ready


def test_blocked_robot_fails_go_to_without_windup():
    lab = Lab(blocked=True)
    with pytest.raises(ArmFailedError, match="not reached"):
        lab.runs(lab.driver.go_to, (0.55, 0.0, 0.0), Stop())
    assert lab.driver.lead()[0] <= 1.5 * CONFIG.franka.max_lead


def test_stale_poses_end_the_motion():
    lab = Lab()
    outcome = lab.begins(lab.driver.move, (0.1, 0.0, 0.0), 1.0, Stop())
    lab.passes(0.3)
    assert lab.driver.tracking() is not None
    lab.now += CONFIG.franka.state_max_age + TICK
    assert lab.driver.tick() is None
    assert lab.driver.tracking() is None
    outcome.thread.join(10.0)
    assert isinstance(outcome.error, ArmFailedError)
    assert "stale" in lab.driver.why_not_ready()


numbers = st.one_of(st.floats(-1.0, 1.0), st.floats(-1e6, 1e6))
tilts = st.tuples(*(st.floats(-0.5, 0.5),) * 2)
camera_poses = st.builds(CameraPose, st.tuples(*(numbers,) * 3), numbers, tilts)
trackings = st.builds(Tracking, camera_poses, st.tuples(*(numbers,) * 3), camera_poses)
periods = st.one_of(st.floats(1e-4, 0.05), st.sampled_from([TICK, 1.0, 3600.0]))


def camera_velocity(twist, measured):
    """Return the camera's velocity (6,): x, y, theta, height, tilt about x and y."""
    (linear, angular), mount = twist, CameraMount.from_config(CONFIG)
    _, rotation = mount.end_effector(measured)
    x, y, z = linear + np.cross(angular, rotation @ mount.position)
    return np.array([x, y, angular[2], z, *angular[:2]])


@given(legs=st.lists(st.tuples(trackings, periods, st.integers(1, 20)), max_size=6))
def test_twist_stays_within_limits_for_any_tracking(legs):
    tracker, before = VelocityTracker(CONFIG), np.zeros(6)
    for tracking, period, ticks in legs:
        for _ in range(ticks):
            velocity = camera_velocity(tracker.twist(tracking, period), tracking.measured)
            assert np.all(np.abs(velocity) <= TOP + ROUNDING)
            assert np.all(np.abs(velocity - before) <= min(period, MAX_PERIOD) * ACCELERATION + ROUNDING)
            before = velocity
