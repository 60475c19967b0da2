"""Preflight checks on good and bad input, without a ROS master."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
import rospy
from sensor_msgs.msg import CameraInfo

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.franka.report import CONTROLLER, Controller, RobotMode
from embodied_active_learning.geometry import fixed_axes_rotation, intrinsics, optical_rotation
from embodied_active_learning.ros.conversions import camera_info_message
from embodied_active_learning.ros.preflight import computer, images, network, reach, robot
from embodied_active_learning.ros.preflight.check_result import (
    Level,
    error,
    most_severe,
    ok,
    summary,
    warning,
)
from embodied_active_learning.ros.preflight.network import OwnAddress, Peer
from embodied_active_learning.ros.preflight.robot import STATE_CONTROLLER
from embodied_active_learning.ros.preflight.run import find_config
from embodied_active_learning.ros.preflight.topics import TopicLimits, TopicStatistics, check_topic

CONFIG = Config()
FRANKA = replace(CONFIG, arm=replace(CONFIG.arm, robot="franka"))
LIMITS = TopicLimits(max_age=0.5, max_future=0.1)
STEADY = tuple(np.arange(0.1, 3.0, 0.1))


def with_franka(**changes):
    return replace(FRANKA, franka=replace(FRANKA.franka, **changes))


def levels(results):
    return [result.level.name for result in results]


@pytest.mark.parametrize(
    ("profile", "expected"), [("camera: {}", "franka"), ("arm: {robot: velocity_service}", "velocity_service")]
)
def test_robot_profile_names_the_robot(tmp_path, profile, expected):
    path = tmp_path / "lab.yaml"
    path.write_text(profile)
    config, _ = find_config(str(path), has_master=False)
    assert config.arm.robot == expected


def test_summary_and_exit_status_of_the_most_severe_result():
    good, doubt = ok("disk", "enough"), warning("focus", "soft", "reason", "remedy")
    bad = error("arm", "missing", "reason", "remedy")
    assert [most_severe(results).value for results in ([good], [good, doubt], [good, doubt, bad])] == [0, 2, 1]
    assert summary([good]) == "ready (1 of 1 checks OK)"
    assert summary([good, doubt]) == "ready (warnings: focus)"
    assert summary([good, doubt, bad]) == "not ready (errors: arm; warnings: focus)"


def test_error_has_reason_and_remedy():
    assert ok("disk", "enough").describe() == "OK      disk                    enough"
    lines = error("arm", "missing", "nothing moves", "start it").describe().splitlines()
    assert [line.split(None, 1)[0] for line in lines] == ["ERROR", "reason:", "remedy:"]
    assert lines[1].endswith("nothing moves")
    assert lines[2].endswith("start it")


@pytest.mark.parametrize(
    ("statistics", "limits", "level", "message"),
    [
        (TopicStatistics("/x", 3.0, STEADY, [0.02] * 29), LIMITS, "OK", "/x at 10.0 Hz, 0.020 s old"),
        (TopicStatistics("/x", 3.0, published=False), LIMITS, "ERROR", "/x has no publisher"),
        (TopicStatistics("/x", 3.0), LIMITS, "ERROR", "no message on /x in 3.0 s"),
        (TopicStatistics("/x", 3.0, STEADY, [-0.3] * 29), LIMITS, "ERROR", "0.30 s in the future"),
        (TopicStatistics("/x", 3.0, STEADY, [0.7] * 29), LIMITS, "ERROR", "0.700 s old (limit 0.5 s)"),
        (TopicStatistics("/x", 3.0, STEADY[:20], [0.0] * 20), LIMITS, "ERROR", "gap 1.00 s"),
        (TopicStatistics("/x", 3.0, (0.1, 2.0, 2.9), [0.0] * 3), LIMITS, "ERROR", "gap 1.90 s"),
        (TopicStatistics("/x", 0.2, (0.1,), [1e9]), None, "OK", "/x is published"),
        (TopicStatistics("/x", 0.2), None, "ERROR", "no message"),
    ],
)
def test_topic_publisher_rate_and_age(statistics, limits, level, message):
    result = check_topic("topic", statistics, "reason", "start it", limits)
    assert result.level.name == level
    assert message in result.message


def scene(seed=0):
    """Return an image (180, 180, 3) of grey patches with edges."""
    patches = np.random.default_rng(seed).integers(60, 200, (12, 12, 3), dtype=np.uint8)
    return np.repeat(np.repeat(patches, 15, axis=0), 15, axis=1)


def only(results, name):
    return next(result for result in results if result.name == name)


def test_good_images_pass():
    assert levels(images.check_content([scene(0), scene(1), scene(2)], CONFIG.camera, real=True)) == ["OK", "OK"]


def test_covered_lens_is_an_error_unless_allowed():
    covered = np.full((180, 180, 3), 20, np.uint8)
    assert "the colour [20, 20, 20]" in images.check_content([covered], CONFIG.camera, True)[0].message
    plain = replace(CONFIG.camera, allow_featureless=True)
    assert "the colour" not in images.check_content([covered], plain, True)[0].message


def test_frozen_camera_is_a_warning_except_in_simulation():
    result = only(images.check_content([scene()] * 3, CONFIG.camera, real=True), "image content")
    assert result.level is Level.WARNING
    assert "the last 3 images are identical" in result.message
    assert levels(images.check_content([scene()] * 3, CONFIG.camera, real=False)) == ["OK", "OK"]


@pytest.mark.parametrize(
    ("image", "name", "remedy"),
    [
        (np.where(scene() > 150, 255, scene()), "exposure", "lower the exposure"),
        (np.where(scene() < 120, 2, 3).astype(np.uint8), "exposure", "raise the exposure"),
        (cv2.GaussianBlur(scene(), (0, 0), 12), "sharpness", "focus"),
    ],
    ids=["too bright", "too dark", "out of focus"],
)
def test_poor_image_is_a_warning(image, name, remedy):
    result = only(images.check_content([image], CONFIG.camera, real=True), name)
    assert result.level is Level.WARNING
    assert remedy in result.remedy


@pytest.mark.parametrize(
    ("degrees", "size", "level"),
    [(30.0, (180, 180), "OK"), (30.5, (180, 180), "OK"), (33.0, (180, 180), "WARNING"), (30.0, (360, 640), "ERROR")],
)
def test_camera_matrix_is_compared_with_settings(degrees, size, level):
    info = camera_info_message(rospy.Time(), intrinsics(size[1], size[0], degrees), *size)
    assert images.check_camera_matrix(info, CONFIG.camera).level.name == level


def test_missing_camera_matrix_is_an_error():
    info = CameraInfo(height=180, width=180)
    assert images.check_camera_matrix(info, CONFIG.camera).level is Level.ERROR


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"K": [335.9, 0, 109.5, 0, 335.9, 89.5, 0, 0, 1]}, "optical axis +20.0, +0.0 px off centre"),
        ({"K": [403.0, 0, 89.5, 0, 335.9, 89.5, 0, 0, 1]}, "fx/fy 1.200"),
        ({"D": [-0.9, 0.12, 0, 0, 0]}, "distortion plumb_bob"),
        ({"D": [1.0], "distortion_model": "mei"}, "distortion model 'mei' is not supported"),
    ],
    ids=["axis", "aspect", "distortion", "unknown model"],
)
def test_wrong_camera_geometry_is_a_warning(changes, words):
    info = camera_info_message(rospy.Time(), intrinsics(180, 180, 30.0), 180, 180)
    for name, value in changes.items():
        setattr(info, name, value)
    result = images.check_camera_matrix(info, CONFIG.camera)
    assert result.level is Level.WARNING
    assert words in result.message


@pytest.mark.parametrize(
    ("mode", "errors", "rate", "expected"),
    [
        (1, [], 0.0, {"robot mode": "OK"}),
        (2, [], 0.99, {"robot mode": "OK", "robot network": "OK"}),
        (2, [], 0.8, {"robot mode": "OK", "robot network": "WARNING"}),
        (4, ["cartesian_reflex"], 0.0, {"robot mode": "ERROR"}),
        (5, [], 0.0, {"robot mode": "ERROR"}),
        (1, ["joint_reflex"], 0.0, {"robot mode": "ERROR"}),
        (77, [], 0.0, {"robot mode": "ERROR"}),
    ],
)
def test_robot_mode_errors_and_success_rate(mode, errors, rate, expected):
    results = robot.check_robot_state(mode, errors, rate)
    assert {result.name: result.level.name for result in results} == expected
    assert all(name in results[0].message for name in errors)


def test_user_stop_remedy_is_to_release_it():
    assert "release the user stop" in robot.check_robot_state(5, [], 0.0)[0].remedy


RUNNING, READING, STOPPED = Controller("running", True), Controller("running", False), Controller("stopped", True)
OTHER = "effort_joint_trajectory_controller"


@pytest.mark.parametrize(
    ("controllers", "message"),
    [
        ({STATE_CONTROLLER: READING, CONTROLLER: RUNNING}, "nothing else moves the arm"),
        ({CONTROLLER: RUNNING}, f"{STATE_CONTROLLER} is not loaded"),
        ({STATE_CONTROLLER: READING}, f"{CONTROLLER} is not loaded"),
        ({STATE_CONTROLLER: READING, CONTROLLER: STOPPED}, f"{CONTROLLER} is stopped"),
        ({STATE_CONTROLLER: READING, CONTROLLER: STOPPED, OTHER: RUNNING}, f"{OTHER} controls the arm"),
        ({STATE_CONTROLLER: READING, CONTROLLER: RUNNING, OTHER: STOPPED}, "nothing else moves the arm"),
    ],
)
def test_controllers_run_and_no_other_moves_the_arm(controllers, message):
    results = robot.check_controllers(controllers, ["/franka_arm"])
    assert len(results) == 1
    assert message in results[0].message
    assert (results[0].level is Level.OK) == ("nothing else" in message)


def test_second_publisher_of_set_points_is_named():
    controllers = {STATE_CONTROLLER: READING, CONTROLLER: RUNNING}
    result = robot.check_controllers(controllers, ["/franka_arm", "/interactive_marker"])[0]
    assert result.level is Level.ERROR
    assert "/interactive_marker" in result.message


def camera_pose(position, tilt, config=FRANKA):
    """Return the pose of a camera whose optical axis is tilted from straight down about the base frame's y."""
    transform = np.eye(4)
    transform[:3, :3] = fixed_axes_rotation((0.0, tilt, 0.0)) @ optical_rotation(0.0)
    transform[:3, 3] = position
    return robot.camera_pose(transform, config)


@pytest.mark.parametrize(
    ("position", "tilt", "level"),
    [
        ((0.475, 0.0, 0.3), 0.0, "OK"),
        ((0.475, 0.0, 0.31), 0.1, "OK"),
        ((0.475, 0.0, 0.34), 0.0, "ERROR"),
        ((0.475, 0.0, 0.3), 0.3, "ERROR"),
        ((0.475, 0.2, 0.3), 0.0, "WARNING"),
        ((0.475, 0.4, 0.3), 0.0, "ERROR"),
    ],
)
def test_camera_pose_limits_of_height_tilt_and_workspace(position, tilt, level):
    assert robot.check_camera_pose(camera_pose(position, tilt), FRANKA).level.name == level


def test_camera_height_is_measured_from_the_table():
    arm = with_franka(table_height=0.15)
    assert robot.check_camera_pose(camera_pose((0.475, 0.0, 0.45), 0.0, arm), arm).level is Level.OK


def test_camera_that_looks_up_has_no_pose():
    with pytest.raises(ObservationError, match="looks up"):
        camera_pose((0.475, 0.0, 0.3), math.pi)


def test_frames_differ_in_millimetres_and_yaw_wraps():
    assert robot.check_frames((0.4, 0.1, math.pi - 0.001), (0.401, 0.1, -math.pi + 0.001)).level is Level.OK
    result = robot.check_frames((0.4, 0.1, 0.0), (0.405, 0.1, 0.0))
    assert result.level is Level.ERROR
    assert "5.0 mm" in result.message


def test_arm_reaches_default_workspace():
    result = reach.check_reach(reach.find_reach(CONFIG))
    assert result.level is Level.OK
    assert "joint 4 is closest" in result.message


def test_unreachable_corner_is_named():
    far = replace(CONFIG, workspace=replace(CONFIG.workspace, x=(0.325, 0.95)))
    found = reach.find_reach(far)
    assert found.unreachable
    assert min(pose[0] for pose in found.unreachable) > 0.7
    result = reach.check_reach(found)
    assert result.level is Level.ERROR
    assert f"x {found.unreachable[0][0]:.3f} m" in result.message


def test_reach_depends_on_camera_mount_and_end_effector():
    """A camera turned in its mount costs the last joint its range; F_T_EE turned the other way gives it back."""
    straight = with_franka(camera_position=(0.0, 0.0, 0.05))
    turned = with_franka(camera_position=(0.0, 0.0, 0.05), camera_rotation=(0.0, 0.0, 0.8))
    assert not reach.find_reach(straight).unreachable
    assert {pose[2] for pose in reach.find_reach(turned).unreachable} == {CONFIG.workspace.theta[1]}
    end_effector = np.eye(4)
    end_effector[:2, :2] = [[math.cos(0.8), math.sin(0.8)], [-math.sin(0.8), math.cos(0.8)]]
    assert not reach.find_reach(turned, end_effector).unreachable


def test_reach_uses_the_joint_limits_of_the_arm():
    """Joint 4 of an FR3 bends 0.03 rad less than a Panda's."""
    margins = {arm: reach.find_reach(with_franka(arm_id=arm)).margin for arm in ("panda", "fr3")}
    assert margins["panda"] - margins["fr3"] == pytest.approx(0.0297, abs=1e-4)


def test_joint_close_to_its_limit_is_a_warning():
    assert reach.check_reach(reach.Reach((), 0.01, 7, (0.4, 0.0, 2.0))).level is Level.WARNING


def test_missing_packages_are_named_with_install_command():
    required = {"torch": "make install", "franka_msgs": "apt-get install ros-noetic-franka-ros"}
    assert computer.check_packages(required, []).level is Level.OK
    result = computer.check_packages(required, ["franka_msgs"])
    assert result.level is Level.ERROR
    assert "franka_msgs" in result.message
    assert "ros-noetic-franka-ros" in result.remedy


def test_full_disk_is_an_error(tmp_path):
    assert computer.check_disk(tmp_path / "sessions", CONFIG).level is Level.OK
    large = replace(
        CONFIG, exploration=replace(CONFIG.exploration, steps=1000000), camera=replace(CONFIG.camera, width=4096)
    )
    assert computer.check_disk(tmp_path, large).level is Level.ERROR


@pytest.mark.parametrize(
    ("device", "gpu", "problem", "level"),
    [
        ("auto", False, "", "OK"),
        ("auto", True, "", "OK"),
        ("auto", False, "no kernel image", "WARNING"),
        ("cpu", False, "", "OK"),
        ("cuda", True, "", "OK"),
        ("cuda", False, "", "ERROR"),
        ("cuda", False, "no kernel image", "ERROR"),
    ],
)
def test_gpu_must_exist_and_compute(device, gpu, problem, level):
    result = computer.check_device(device, gpu, problem, 2)
    assert result.level.name == level
    assert problem in result.message


def test_other_python_on_path_is_a_warning():
    assert computer.check_interpreter("/checkout/.venv", "/checkout/.venv").level is Level.OK
    result = computer.check_interpreter("/checkout/.venv", "/opt/conda")
    assert result.level is Level.WARNING
    assert "/opt/conda" in result.message


@pytest.mark.parametrize(
    ("simulated", "published", "robot_name", "level"),
    [
        (True, True, "pybullet", "OK"),
        (True, False, "pybullet", "ERROR"),
        (False, False, "pybullet", "ERROR"),
        (False, False, "franka", "OK"),
        (True, False, "franka", "ERROR"),
        (False, True, "franka", "WARNING"),
    ],
)
def test_clock_is_simulated_iff_the_robot_is(simulated, published, robot_name, level):
    assert computer.check_clock(simulated, published, robot_name).level.name == level


HERE = Peer("/trainer", "10.77.0.2", "", local=True)
THERE = Peer("/franka_arm", "10.77.0.1", "", local=False)


VM = OwnAddress("vm", is_loopback=False, is_local=True, addresses=["10.77.0.2"])
IP = VM._replace(host="10.77.0.2")
LOCALHOST = VM._replace(host="localhost", is_loopback=True)
STALE = VM._replace(host="192.168.77.5", is_local=False)


@pytest.mark.parametrize(
    ("own", "environment", "master_is_local", "peers", "level"),
    [
        (VM, {}, True, [HERE], "OK"),
        (LOCALHOST, {"ROS_HOSTNAME": "localhost"}, True, [HERE], "OK"),
        (IP, {"ROS_IP": "10.77.0.2"}, False, [HERE, THERE], "OK"),
        (LOCALHOST, {"ROS_HOSTNAME": "localhost"}, True, [HERE, THERE], "ERROR"),
        (LOCALHOST, {"ROS_IP": "127.0.0.1"}, False, [], "ERROR"),
        (STALE, {"ROS_IP": "192.168.77.5"}, True, [HERE], "ERROR"),
        (VM._replace(is_local=False), {}, True, [HERE], "OK"),
        (VM, {}, False, [THERE], "WARNING"),
        (VM, {"ROS_IP": "10.77.0.2", "ROS_HOSTNAME": "vm"}, True, [HERE], "WARNING"),
    ],
)
def test_own_address_is_reachable_for_other_computers(own, environment, master_is_local, peers, level):
    assert network.check_own_address(own, environment, master_is_local, peers).level.name == level
    assert network.check_peers(peers).level is Level.OK


def test_stale_ros_ip_is_compared_with_own_addresses():
    result = network.check_own_address(STALE, {"ROS_IP": "192.168.77.5"}, True, [])
    assert result.message == "ROS_IP=192.168.77.5 is not an address of this computer, which has 10.77.0.2"


def test_unreachable_node_is_named():
    assert network.check_peers([HERE._replace(connection_error="Connection refused")]).level is Level.ERROR
    result = network.check_peers([HERE, THERE._replace(connection_error="Name or service not known")])
    assert result.level is Level.ERROR
    assert result.message == "no connection to /franka_arm at 10.77.0.1 (Name or service not known)"


def test_persistent_parameters_have_remedies():
    assert levels(computer.check_persistent_parameters({"/failure": "", "/arm/stopped_by": ""})) == ["OK"]
    values = {"/failure": "/trainer: disk full", "/arm/stopped_by": "an operator"}
    results = computer.check_persistent_parameters(values)
    assert levels(results) == ["WARNING", "WARNING"]
    assert "/arm/recover" in results[1].remedy
    held = computer.check_persistent_parameters({"/arm/held_for": "the user stop was pressed"})
    assert "/arm/recover" in held[0].remedy


def test_remedies_name_services_in_namespace(monkeypatch):
    monkeypatch.setattr(rospy, "resolve_name", lambda name: f"/lab/{name}")
    values = {"/lab/arm/held_for": "the user stop was pressed", "/lab/ergodic_planner/paused_by": "/operator"}
    held, paused = computer.check_persistent_parameters(values)
    assert held.remedy == "check the robot, then rosservice call /lab/arm/recover"
    assert paused.remedy == "rosservice call /lab/planner/resume"
    state = robot.check_robot_state(RobotMode.USER_STOPPED, [], 1.0)[0]
    assert state.remedy == "release the user stop, then rosservice call /lab/arm/recover"


def test_missing_services_are_named():
    arguments = (["/arm/move"], "services", "reason", "start it")
    assert computer.check_advertised(["/arm/move", "/x"], *arguments).level is Level.OK
    result = computer.check_advertised(["/x"], *arguments)
    assert result.message == "not advertised: /arm/move"


def test_load_differing_from_the_configured_one_is_an_error():
    config = Config.from_dict({"franka": {"load_mass": 0.3}})
    assert robot.check_load(0.3, config).level is Level.OK
    result = robot.check_load(0.0, config)
    assert result.level is Level.ERROR
    assert "franka/load_mass is 0.3 kg" in result.message


def test_other_camera_controls_are_an_error_with_the_command():
    assert robot.check_camera_controls("/dev/video0", {"auto_exposure": 1}, {}).level is Level.OK
    result = robot.check_camera_controls("/dev/video0", {"auto_exposure": 3}, {"auto_exposure": (3, 1)})
    assert result.level is Level.ERROR
    assert "auto_exposure is 3, not 1" in result.message
    assert result.remedy == "v4l2-ctl --device /dev/video0 --set-ctrl auto_exposure=1"
