"""Start and recovery of an arm with velocity service; without a master."""

from types import SimpleNamespace

import numpy as np
import pytest

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ArmNotReadyError, RobotError, ServiceError
from embodied_active_learning.franka.mount import CameraMount, CameraPose
from embodied_active_learning.franka.report import RobotMode
from embodied_active_learning.franka.velocity_tracking import velocity_driver
from embodied_active_learning.ros.arm import velocity_interface, velocity_supervisor
from embodied_active_learning.ros.arm.velocity_interface import VelocityInterface

CONFIG = Config.from_dict({"arm": {"robot": "velocity_service"}})


class Lab:
    """A supervisor and its driver, on a clock that the test advances."""

    def __init__(self):
        self.now = 10.0
        self.speed = 0.0  # m/s along x
        self.sends_poses = True
        self.starts = 0  # of the controller
        self._transform = np.eye(4)
        pose = CameraPose(tuple(CONFIG.workspace.box().centre), 0.0, (0.0, 0.0))
        self._transform[:3, 3], self._transform[:3, :3] = CameraMount.from_config(CONFIG).end_effector(pose)
        self.driver = velocity_driver(CONFIG, lambda: self.now)
        self.driver.wait_until_ready = self.passes
        self.start_error = None
        interface = SimpleNamespace(start=self.start)
        self.supervisor = velocity_supervisor.VelocitySupervisor(interface, self.driver, CONFIG.franka)
        self.passes(0.3)

    def start(self, rate):
        assert rate == CONFIG.franka.rate
        if self.start_error is not None:
            raise self.start_error
        self.starts += 1

    def moves(self, speed):
        """Move the arm at a speed [m/s] for half a second."""
        self.speed = speed
        self.passes(0.5)

    def passes(self, seconds):
        for _ in range(round(seconds / 0.05)):
            self.now += 0.05
            self._transform[0, 3] += 0.05 * self.speed
            pose = self._transform.T.ravel()
            if self.sends_poses:
                self.driver.update_state(self.now, 0.0, pose, RobotMode.OTHER)
            self.driver.tick()
        return not self.driver.why_not_ready()


@pytest.fixture
def lab(monkeypatch):
    monkeypatch.setattr(velocity_supervisor, "WallTimer", lambda period, function: None)
    return Lab()


def test_controller_is_started_only_at_rest(lab):
    lab.moves(0.02)
    lab.supervisor.check()
    assert lab.starts == 0
    lab.moves(0.0)
    lab.supervisor.check()
    assert lab.starts == 1
    assert lab.passes(0.1)


def test_recovery_of_moving_arm_is_rejected(lab):
    lab.supervisor.check()
    lab.driver.update_control(errors=("stopped",))
    lab.moves(0.02)
    with pytest.raises(ArmNotReadyError, match="the arm is not known to be at rest"):
        lab.supervisor.recover()
    assert lab.starts == 1
    lab.moves(0.0)
    lab.supervisor.recover()
    assert lab.starts == 2


def test_failed_recovery_holds_robot(lab):
    lab.supervisor.check()
    lab.sends_poses = False
    lab.passes(0.5)
    with pytest.raises(ArmNotReadyError, match="poses of the robot are stale"):
        lab.supervisor.recover()
    lab.sends_poses = True
    lab.passes(0.5)
    lab.supervisor.check()
    assert "the requested recovery failed (the arm is not known to be at rest: poses" in lab.driver.why_not_ready()
    lab.supervisor.recover()
    assert not lab.driver.why_not_ready()


def test_reason_for_missing_start_is_reported(lab):
    lab.moves(0.02)
    lab.supervisor.check()
    assert "started once the arm is at rest" in lab.driver.why_not_ready()
    lab.moves(0.0)
    lab.start_error = ServiceError("no response from /klerg_start_pose: it is not advertised")
    lab.supervisor.check()
    assert lab.driver.why_not_ready() == str(lab.start_error)


def test_start_is_retried_if_service_does_not_respond(lab):
    lab.start_error = ServiceError("no response")
    lab.supervisor.check()
    lab.start_error = None
    lab.supervisor.check()
    assert lab.starts == 1


def test_controller_is_restarted_after_lost_service(lab):
    """The robot's node was restarted: its controller is in an unknown mode."""
    lab.supervisor.check()
    with lab.driver.readiness() as readiness:
        readiness.set_unprepared("no response from /klerg_cmd", retry=True)
    assert lab.driver.why_not_ready() == "no response from /klerg_cmd"
    lab.supervisor.check()
    assert lab.starts == 2
    assert not lab.driver.why_not_ready()


def test_reason_of_lost_service_is_kept_until_rest(lab):
    lab.supervisor.check()
    with lab.driver.readiness() as readiness:
        readiness.set_unprepared("no response from /klerg_cmd", retry=True)
    lab.moves(0.02)
    lab.supervisor.check()
    assert lab.driver.why_not_ready() == "no response from /klerg_cmd"


def test_start_that_robot_rejects_is_not_retried(lab):
    lab.start_error = RobotError("the robot does not follow")
    lab.supervisor.check()
    lab.start_error = None
    lab.supervisor.check()
    assert lab.starts == 0


def set_step(monkeypatch, response):
    """Make the master respond to requests for the period of the velocity controller."""
    master = SimpleNamespace(getParam=lambda caller, name: response())
    monkeypatch.setattr(velocity_interface, "master_proxy", lambda: master)


@pytest.mark.parametrize("step", ["fast", None, [0.2]])
def test_step_that_is_no_number_is_reported(monkeypatch, step):
    set_step(monkeypatch, lambda: (1, "", step))
    with pytest.raises(RobotError, match=r"parameter /dt is .*, not seconds"):
        VelocityInterface.start(None, 100.0)


def test_missing_master_is_reported(monkeypatch):
    def refuse():
        raise ConnectionRefusedError("refused")

    set_step(monkeypatch, refuse)
    with pytest.raises(ServiceError, match="no response from the ROS master: refused"):
        VelocityInterface.start(None, 100.0)


def test_too_few_requests_per_step_are_rejected(monkeypatch):
    set_step(monkeypatch, lambda: (1, "", 0.02))
    with pytest.raises(RobotError, match=r"100 Hz gives fewer than 3 requests per step .* raise franka/rate"):
        VelocityInterface.start(None, 100.0)
