"""The stand-in for franka_ros moves, stops, rejects and recovers as a Panda under franka_ros does."""

import math

import cv2
import numpy as np
import pytest

from embodied_active_learning.config import Config
from embodied_active_learning.simulation.scene import Scene
from embodied_active_learning.simulation.world import load_world
from fake_franka.camera import TableCamera, encode
from fake_franka.controllers import (
    BEST_EFFORT,
    DEFAULT_CONTROLLERS,
    IMPEDANCE_TYPE,
    JOINTS,
    RUNNING,
    STOPPED,
    STRICT,
    ControllerError,
    ControllerManager,
)
from fake_franka.impedance import inverse, multiply, rotation_vector, turned_by
from fake_franka.joints import JointTracker
from fake_franka.robot import IDLE, MOVE, RECOVERY, REFLEX, USER_STOPPED, Behaviour, CommandError, FakeRobot

START = (0.475, 0.0, 0.3)
DOWN = (1.0, 0.0, 0.0, 0.0)
IMPEDANCE = "cartesian_impedance_example_controller"
PARAMETERS = {
    **DEFAULT_CONTROLLERS,
    IMPEDANCE: {"type": IMPEDANCE_TYPE, "arm_id": "panda", "joint_names": list(JOINTS)},
    "joint_velocity_example_controller": {"type": "franka_example_controllers/JointVelocityExampleController"},
}


class Lab:
    """A robot, a clock that the test advances, and a stream of set-points at 100 Hz."""

    def __init__(self, drives=True, **behaviour):
        self.now = 0.0
        self.log = []
        self.robot = FakeRobot(lambda: self.now, START, DOWN, Behaviour(**behaviour), log=self.log.append)
        if drives:
            self.robot.change_controllers(moves_the_arm=True, impedance=True)
            self.wait(3.0)  # the controller raises its stiffness from zero

    def wait(self, seconds, period=0.005):
        for _ in range(round(seconds / period)):
            self.now += period
            self.robot.advance()

    def stream(self, seconds, velocity=0.0, turn_rate=0.0):
        """Stream set-points that move in y and about z from the last one."""
        (x, y, z), orientation = self.robot.hand.set_point
        for tick in range(1, round(100 * seconds) + 1):
            turn = multiply(turned_by((0.0, 0.0, turn_rate * tick / 100)), orientation)
            self.robot.take_set_point((x, y + velocity * tick / 100, z), turn)
            self.wait(0.01)

    def send(self, y):
        self.robot.take_set_point((START[0], y, START[2]), DOWN)

    def recover(self):
        self.robot.begin_recovery()
        self.wait(0.1)
        self.robot.end_recovery()

    @property
    def y(self):
        return self.robot.hand.position[1]


@pytest.fixture
def lab():
    return Lab()


def test_hand_trails_by_filter_and_damping(lab):
    lab.stream(2.5, velocity=0.1)
    assert (lab.robot.hand.set_point[0][1] - lab.y) / 0.1 == pytest.approx(0.2 + 2.0 / math.sqrt(200.0), abs=0.01)


def test_turn_trails_by_the_law_of_the_error_quaternion(lab):
    lab.stream(8.0, turn_rate=0.3)
    hand = lab.robot.hand
    behind = rotation_vector(multiply(hand.set_point[1], inverse(hand.orientation)))
    assert behind[2] == pytest.approx(0.3 * 0.2 + 2.0 * math.asin(2.0 * 0.3 / math.sqrt(10.0)), abs=0.01)


def test_torque_is_stiffness_times_sine_of_half_the_error(lab):
    """As in cartesian_impedance_example_controller: the vector part of the error quaternion."""
    hand = lab.robot.hand
    hand.set_stiffness(200.0, 20.0)
    lab.wait(3.0)
    hand.set_point = (hand.set_point[0], multiply(turned_by((0.0, 0.0, 0.5)), hand.orientation))
    hand._target_orientation = hand.set_point[1]
    hand.advance()
    assert hand.torque[2] == pytest.approx(20.0 * math.sin(0.25), abs=1e-3)


def test_stiffer_controller_trails_less(lab):
    lab.robot.hand.set_stiffness(400.0, 30.0)
    lab.wait(2.0)
    lab.stream(2.5, velocity=0.1)
    assert (lab.robot.hand.set_point[0][1] - lab.y) / 0.1 == pytest.approx(0.2 + 2.0 / math.sqrt(400.0), abs=0.01)


def test_friction_stops_hand_short_of_set_point():
    lab = Lab(friction=2.0)
    lab.send(0.05)
    lab.wait(4.0)
    assert 0.005 < 0.05 - lab.y <= 2.0 / 200.0 + 1e-6


def test_motion_is_independent_of_update_period():
    often, seldom = Lab(), Lab()
    for lab, period in ((often, 0.005), (seldom, 0.5)):
        lab.send(0.08)
        lab.wait(1.5, period)
    assert seldom.y == pytest.approx(often.y, abs=1e-9)


def test_distant_set_point_trips_reflex(lab):
    lab.stream(1.0, velocity=0.05)
    lab.send(lab.y + 0.3)
    assert lab.robot.mode == REFLEX
    assert lab.robot.errors == lab.robot.last_motion_errors == {"cartesian_reflex"}
    assert 'aborted by reflex! ["cartesian_reflex"]' in lab.log[-1]
    lab.wait(0.2)
    stands_at = lab.y
    lab.stream(1.0, velocity=0.05)
    assert lab.y == stands_at


def test_force_above_limit_trips_reflex():
    lab = Lab(drives=False)
    lab.robot.command("Set Collision Behavior", lambda: setattr(lab.robot, "force_limits", (2.0,) * 6))
    lab.robot.change_controllers(moves_the_arm=True, impedance=True)
    lab.wait(3.0)
    lab.send(0.08)
    lab.wait(1.0)
    assert lab.robot.mode == REFLEX
    assert abs(lab.robot.felt[1]) > 2.0


def test_recovery_restarts_controller_at_present_pose(lab):
    lab.stream(1.0, velocity=0.1)
    lab.robot.reflex("cartesian_reflex")
    lab.wait(0.2)
    stands_at = lab.y
    lab.send(0.05)  # discarded: the controller is not active
    lab.robot.begin_recovery()
    assert lab.robot.mode == RECOVERY
    lab.robot.end_recovery()
    assert lab.robot.mode == MOVE
    assert not lab.robot.errors
    lab.wait(1.0)
    assert lab.y == pytest.approx(stands_at, abs=1e-9)
    lab.stream(2.0, velocity=0.02)
    assert lab.y > stands_at + 0.02


def test_started_controller_ignores_earlier_set_points():
    lab = Lab(drives=False)
    lab.send(0.05)
    lab.robot.change_controllers(moves_the_arm=True, impedance=True)
    lab.wait(1.0)
    assert lab.robot.take_truth()["max_speed"] == 0.0


def test_recoveries_fail_as_often_as_configured(lab):
    lab.robot.reflex("cartesian_reflex")
    lab.robot.fail_next_recovery()
    lab.robot.fail_next_recovery()
    for _ in range(2):
        with pytest.raises(CommandError, match="manual error recovery required"):
            lab.recover()
        assert lab.robot.mode == REFLEX
    lab.recover()
    assert lab.robot.mode == MOVE


def test_recovery_ignores_errors_from_before_a_restart():
    """As from franka_ros 0.10.2 on: only a rejected motion of its own makes franka_control recover the robot."""
    lab = Lab(recovers_own_errors_only=True)
    lab.robot.restart_control()
    for _ in range(2):
        lab.recover()
        assert lab.robot.mode == REFLEX
    lab.robot.change_controllers(moves_the_arm=True, impedance=True)
    assert "Move command rejected" in lab.log[-1]
    lab.recover()
    assert lab.robot.mode == MOVE
    assert not lab.robot.errors


def test_setters_are_rejected_in_motion_and_reflex(lab):
    done = []
    text = r'libfranka: Set Load command rejected: command not possible in the current mode \("{}"\)!'
    with pytest.raises(CommandError, match=text.format("Move")):
        lab.robot.command("Set Load", lambda: done.append(1))
    lab.robot.reflex("cartesian_reflex")
    with pytest.raises(CommandError, match=text.format("Reflex")):
        lab.robot.command("Set Load", lambda: done.append(2))
    lab.recover()
    lab.robot.change_controllers(moves_the_arm=False, impedance=False)
    assert lab.robot.mode == IDLE
    lab.robot.command("Set Load", lambda: done.append(3))
    assert done == [3]


def test_released_user_stop_needs_recovery(lab):
    lab.stream(1.0, velocity=0.1)
    lab.robot.set_user_stop(True)
    assert lab.robot.mode == USER_STOPPED
    assert not lab.robot.errors
    lab.wait(0.2)
    stands_at = lab.y
    with pytest.raises(CommandError, match="User stopped"):
        lab.robot.begin_recovery()
    lab.robot.set_user_stop(False)
    assert lab.robot.mode == IDLE
    lab.stream(0.5, velocity=0.1)
    assert lab.y == stands_at
    lab.recover()
    assert lab.robot.mode == MOVE


def test_controller_started_during_user_stop_is_inactive():
    lab = Lab(drives=False)
    lab.robot.set_user_stop(True)
    lab.robot.change_controllers(moves_the_arm=True, impedance=True)
    assert "Move command rejected" in lab.log[-1]
    lab.robot.set_user_stop(False)
    assert lab.robot.mode == IDLE
    lab.recover()
    assert lab.robot.mode == MOVE


def test_lost_contact_stops_robot(lab):
    lab.robot.lose_contact()
    assert lab.robot.errors == {"communication_constraints_violation"}


def test_truth_records_motion_and_resets(lab):
    lab.stream(1.0, velocity=0.1)
    truth = lab.robot.take_truth()
    assert truth["set_points"] == 100
    assert 0.08 < truth["max_speed"] < 0.11
    assert 0.1 < truth["max_acceleration"] < 1.0
    lab.robot.reflex("cartesian_reflex")
    assert lab.robot.take_truth()["reflexes"] == 1
    assert lab.robot.take_truth()["reflexes"] == 0


@pytest.fixture
def manager():
    manager = ControllerManager(PARAMETERS.get)
    for name in ("franka_state_controller", "position_joint_trajectory_controller", IMPEDANCE):
        manager.load(name)
    manager.switch(["franka_state_controller"], [], STRICT)
    return manager


def states(manager):
    return {one.name: one.state for one in manager.loaded}


def test_strict_switch_is_all_or_nothing(manager):
    with pytest.raises(ControllerError, match="no controller with this name exists"):
        manager.switch([IMPEDANCE, "unknown"], [], STRICT)
    with pytest.raises(ControllerError, match="since it is not running"):
        manager.switch([IMPEDANCE], ["position_joint_trajectory_controller"], STRICT)
    assert not manager.moving
    assert manager.switch([IMPEDANCE, "unknown"], ["position_joint_trajectory_controller"], BEST_EFFORT)
    assert manager.moving == [IMPEDANCE]
    with pytest.raises(ControllerError, match="already running"):
        manager.switch([IMPEDANCE], [], STRICT)
    assert not manager.switch([IMPEDANCE], [], BEST_EFFORT)
    assert manager.switch([], [IMPEDANCE], STRICT)
    assert states(manager)[IMPEDANCE] == STOPPED


def test_same_interface_conflicts_but_effort_and_position_do_not(manager):
    manager.load("joint_velocity_example_controller")
    manager.switch(["position_joint_trajectory_controller"], [], STRICT)
    with pytest.raises(ControllerError, match="resource conflict"):
        manager.switch(["joint_velocity_example_controller"], [], STRICT)
    manager.switch([IMPEDANCE], [], STRICT)
    assert states(manager)[IMPEDANCE] == states(manager)["position_joint_trajectory_controller"] == RUNNING


def test_load_requires_parameters_of_known_type(manager):
    with pytest.raises(ControllerError, match="type was not specified"):
        manager.load("unknown")
    with pytest.raises(ControllerError, match="already loaded"):
        manager.load(IMPEDANCE)
    for missing, text in (("arm_id", "parameter arm_id"), ("joint_names", "no joint_names")):
        values = {key: value for key, value in PARAMETERS[IMPEDANCE].items() if key != missing}
        with pytest.raises(ControllerError, match=text):
            ControllerManager({IMPEDANCE: values}.get).load(IMPEDANCE)


def test_running_controller_is_not_unloaded(manager):
    with pytest.raises(ControllerError, match="still running"):
        manager.unload("franka_state_controller")
    manager.unload(IMPEDANCE)
    assert IMPEDANCE not in states(manager)


def test_joints_follow_flange():
    flange = np.diag([1.0, -1.0, -1.0, 1.0])
    flange[:3, 3] = START
    tracker = JointTracker(flange)
    for step in range(1, 31):
        flange[1, 3] = 0.1 * step / 30
        joints, speeds = tracker.follow(flange, np.array([0.0, 0.1, 0.0, 0.0, 0.0, 0.0]))
    fresh, _ = JointTracker(flange).follow(flange, np.zeros(6))
    np.testing.assert_allclose(joints, fresh, atol=1e-3)
    assert 0.05 < np.abs(speeds).max() < 2.0


@pytest.fixture(scope="module")
def camera():
    camera = TableCamera(Config(), "diagonal", 640, 360)
    yield camera
    camera.close()


@pytest.fixture(scope="module")
def frame(camera):
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = 0.39, -0.1, 0.3
    return camera.frame(pose)


def test_middle_of_image_is_rendered_by_library(frame):
    config = Config()
    scene = Scene(load_world("diagonal", config.workspace.box()), config.camera)
    rendered = scene.render(np.array([0.39, -0.1, 0.0]), 0.3)
    scene.close()
    middle = frame[:, 140:500]
    assert middle.std() > 5.0
    np.testing.assert_array_equal(cv2.resize(middle, (180, 180), interpolation=cv2.INTER_AREA), rendered)


@pytest.mark.parametrize(
    ("encoding", "decode", "tolerance"),
    [("bgr8", cv2.COLOR_BGR2RGB, 0), ("yuv422", cv2.COLOR_YUV2RGB_UYVY, 4), ("yuv422_yuy2", cv2.COLOR_YUV2RGB_YUY2, 4)],
)
def test_encoded_image_decodes_to_same_colours(frame, encoding, decode, tolerance):
    data, step = encode(frame, encoding)
    packed = np.frombuffer(data, np.uint8).reshape(360, 640, step // 640)
    difference = np.abs(cv2.cvtColor(packed, decode).astype(int) - frame)
    assert np.percentile(difference, 99) <= tolerance
