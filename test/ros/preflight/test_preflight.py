"""The pre-flight checks, each on what is good and on what is bad, without a master."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from embodied_active_learning.config import Config
from embodied_active_learning.franka.readiness import CONTROLLER, Controller
from embodied_active_learning.geometry import intrinsics
from embodied_active_learning.ros.preflight import computer, image, reach, robot
from embodied_active_learning.ros.preflight.check_result import (
    ExitCode,
    Level,
    exit_code,
    fine,
    missing,
    summary,
    warning,
)
from embodied_active_learning.ros.preflight.computer import Peer
from embodied_active_learning.ros.preflight.robot import STATE_CONTROLLER
from embodied_active_learning.ros.preflight.topics import Limits, Stream, check_stream

CONFIG = Config()
FRANKA = replace(CONFIG, arm=replace(CONFIG.arm, robot="franka"))
LIMITS = Limits(longest_gap=0.5, future=0.1)
STEADY = tuple(np.arange(0.1, 3.0, 0.1))


def with_franka(**changes):
    return replace(FRANKA, franka=replace(FRANKA.franka, **changes))


def levels(findings):
    return [finding.level.value for finding in findings]


def test_only_when_all_is_well_the_check_says_so():
    good, doubt = fine("disk", "much"), warning("focus", "soft", "why", "how")
    bad = missing("arm", "gone", "why", "how")
    assert [exit_code(found) for found in ([good], [good, doubt], [good, doubt, bad])] == [
        ExitCode.ALL_WELL,
        ExitCode.WARNINGS,
        ExitCode.MISSING,
    ]
    assert summary([good]).startswith("all is well")
    assert summary([good, doubt]) == "ready, with doubts (WARNING: focus)"
    assert summary([good, doubt, bad]) == "not ready (MISSING: arm; WARNING: focus)"


def test_what_is_not_well_comes_with_its_reason_and_the_way_out():
    assert fine("disk", "much").describe() == "OK      disk                    much"
    lines = missing("arm", "gone", "nothing moves", "start it").describe().splitlines()
    assert [line.split(None, 1)[0] for line in lines] == ["MISSING", "why:", "mend:"]
    assert lines[1].endswith("nothing moves")
    assert lines[2].endswith("start it")


@pytest.mark.parametrize(
    ("stream", "limits", "level", "words"),
    [
        (Stream("/x", 3.0, STEADY, [0.02] * 29), LIMITS, "OK", "/x at 10.0 Hz, 0.020 s old"),
        (Stream("/x", 3.0, published=False), LIMITS, "MISSING", "nobody publishes /x"),
        (Stream("/x", 3.0), LIMITS, "MISSING", "nothing came on /x in 3.0 s"),
        (Stream("/x", 3.0, STEADY, [-0.3] * 29), LIMITS, "MISSING", "0.30 s in the future"),
        (Stream("/x", 3.0, STEADY, [0.7] * 29), LIMITS, "MISSING", "0.700 s old; 0.5 s are allowed"),
        (Stream("/x", 3.0, STEADY[:20], [0.0] * 20), LIMITS, "MISSING", "gap of 1.00 s"),
        (Stream("/x", 3.0, (0.1, 2.0, 2.9), [0.0] * 3), LIMITS, "MISSING", "gap of 1.90 s"),
        (Stream("/x", 0.2, (0.1,), [1e9]), None, "OK", "/x is there"),
        (Stream("/x", 0.2), None, "MISSING", "nothing came"),
    ],
)
def test_a_topic_is_judged_by_who_publishes_how_often_and_how_late(stream, limits, level, words):
    finding = check_stream("topic", stream, "why", "start it", limits)
    assert finding.level.value == level
    assert words in finding.found


def scene(seed=0):
    """Grey patches with edges."""
    patches = np.random.default_rng(seed).integers(60, 200, (12, 12, 3), dtype=np.uint8)
    return np.repeat(np.repeat(patches, 15, axis=0), 15, axis=1)


def only(findings, about):
    return next(finding for finding in findings if finding.about == about)


def test_pictures_of_something_in_good_light_are_well():
    assert levels(image.check_picture([scene(0), scene(1), scene(2)], CONFIG.camera, live=True)) == ["OK", "OK"]


def test_a_covered_lens_is_told_but_where_plain_pictures_are_expected():
    covered = np.full((180, 180, 3), 20, np.uint8)
    assert "one single colour, [20, 20, 20]" in image.check_picture([covered], CONFIG.camera, True)[0].found
    plain = replace(CONFIG.camera, allow_featureless=True)
    assert "one single colour" not in image.check_picture([covered], plain, True)[0].found


def test_a_frozen_camera_is_told_but_a_simulated_one_may_stand_still():
    finding = only(image.check_picture([scene()] * 3, CONFIG.camera, live=True), "picture")
    assert finding.level is Level.WARNING
    assert "same to the last bit" in finding.found
    assert levels(image.check_picture([scene()] * 3, CONFIG.camera, live=False)) == ["OK", "OK"]


@pytest.mark.parametrize(
    ("image", "about", "mend"),
    [
        (np.where(scene() > 150, 255, scene()), "exposure", "lower the camera's exposure"),
        (np.where(scene() < 120, 2, 3).astype(np.uint8), "exposure", "raise the camera's exposure"),
        (cv2.GaussianBlur(scene(), (0, 0), 12), "sharpness", "set the focus"),
    ],
    ids=["too bright", "too dark", "out of focus"],
)
def test_a_picture_that_little_can_be_learned_from_is_a_warning(image, about, mend):
    finding = only(image.check_picture([image], CONFIG.camera, live=True), about)
    assert finding.level is Level.WARNING
    assert mend in finding.mend


@pytest.mark.parametrize(
    ("degrees", "size", "level"),
    [(30.0, (180, 180), "OK"), (30.5, (180, 180), "OK"), (33.0, (180, 180), "WARNING"), (30.0, (360, 640), "MISSING")],
)
def test_the_camera_matrix_is_compared_with_the_settings(degrees, size, level):
    matrix = intrinsics(size[1], size[0], degrees).ravel()
    assert image.check_camera_matrix(matrix, *size, CONFIG.camera).level.value == level


def test_a_camera_without_a_matrix_is_told():
    assert image.check_camera_matrix([0.0] * 9, 180, 180, CONFIG.camera).level is Level.MISSING


@pytest.mark.parametrize(
    ("mode", "errors", "rate", "expected"),
    [
        (1, [], 0.0, {"robot mode": "OK"}),
        (2, [], 0.99, {"robot mode": "OK", "robot network": "OK"}),
        (2, [], 0.8, {"robot mode": "OK", "robot network": "WARNING"}),
        (4, ["cartesian_reflex"], 0.0, {"robot mode": "MISSING"}),
        (5, [], 0.0, {"robot mode": "MISSING"}),
        (1, ["joint_reflex"], 0.0, {"robot mode": "MISSING"}),
        (77, [], 0.0, {"robot mode": "MISSING"}),
    ],
)
def test_the_robots_mode_and_errors_are_told_by_name(mode, errors, rate, expected):
    findings = robot.check_robot_state(mode, errors, rate)
    assert {finding.about: finding.level.value for finding in findings} == expected
    assert all(error in findings[0].found for error in errors)


def test_a_pressed_user_stop_is_mended_by_a_person():
    assert "release the user stop" in robot.check_robot_state(5, [], 0.0)[0].mend


RUNS, LOOKS, STOPPED = Controller("running", True), Controller("running", False), Controller("stopped", True)
THEIRS = "effort_joint_trajectory_controller"


@pytest.mark.parametrize(
    ("controllers", "words"),
    [
        ({STATE_CONTROLLER: LOOKS, CONTROLLER: RUNS}, "nobody else moves the arm"),
        ({CONTROLLER: RUNS}, f"{STATE_CONTROLLER} is not loaded"),
        ({STATE_CONTROLLER: LOOKS}, f"{CONTROLLER} is not loaded"),
        ({STATE_CONTROLLER: LOOKS, CONTROLLER: STOPPED}, f"{CONTROLLER} is stopped"),
        ({STATE_CONTROLLER: LOOKS, CONTROLLER: STOPPED, THEIRS: RUNS}, f"{THEIRS} drives the arm"),
        ({STATE_CONTROLLER: LOOKS, CONTROLLER: RUNS, THEIRS: STOPPED}, "nobody else moves the arm"),
    ],
)
def test_controllers_are_ours_and_nobody_elses(controllers, words):
    findings = robot.check_controllers(controllers, ["/franka_arm"])
    assert len(findings) == 1
    assert words in findings[0].found
    assert (findings[0].level is Level.OK) == ("nobody else" in words)


def test_another_node_that_publishes_set_points_is_named():
    controllers = {STATE_CONTROLLER: LOOKS, CONTROLLER: RUNS}
    finding = robot.check_controllers(controllers, ["/franka_arm", "/interactive_marker"])[0]
    assert finding.level is Level.MISSING
    assert "/interactive_marker" in finding.found


@pytest.mark.parametrize(
    ("place", "tilt", "level"),
    [
        ((0.475, 0.0, 0.3), 0.0, "OK"),
        ((0.475, 0.0, 0.31), 0.1, "OK"),
        ((0.475, 0.0, 0.34), 0.0, "MISSING"),
        ((0.475, 0.0, 0.3), 0.3, "MISSING"),
        ((0.475, 0.2, 0.3), 0.0, "WARNING"),
        ((0.475, 0.4, 0.3), 0.0, "MISSING"),
    ],
)
def test_motion_begins_only_close_to_the_cameras_height_and_upright(place, tilt, level):
    axis = (math.sin(tilt), 0.0, -math.cos(tilt))
    assert robot.check_place(place, axis, 0.0, FRANKA).level.value == level


def test_the_height_is_counted_from_the_table():
    assert robot.check_place((0.475, 0.0, 0.45), (0, 0, -1), 0.0, with_franka(table_height=0.15)).level is Level.OK


def test_frames_that_disagree_are_told_in_millimetres_and_yaw_goes_round():
    assert robot.check_frames((0.4, 0.1, math.pi - 0.001), (0.401, 0.1, -math.pi + 0.001)).level is Level.OK
    finding = robot.check_frames((0.4, 0.1, 0.0), (0.405, 0.1, 0.0))
    assert finding.level is Level.MISSING
    assert "5.0 mm" in finding.found


def test_the_arm_reaches_the_papers_workspace():
    finding = reach.check_reach(reach.find_reach(CONFIG))
    assert finding.level is Level.OK
    assert "joint 4 comes closest" in finding.found


def test_a_corner_out_of_reach_is_named():
    far = replace(CONFIG, workspace=replace(CONFIG.workspace, x=(0.325, 0.95)))
    found = reach.find_reach(far)
    assert found.beyond
    assert min(pose[0] for pose in found.beyond) > 0.7
    finding = reach.check_reach(found)
    assert finding.level is Level.MISSING
    assert f"x {found.beyond[0][0]:.3f} m" in finding.found


def test_a_camera_that_is_turned_in_its_mount_costs_the_last_joint_its_room():
    straight = reach.find_reach(with_franka(camera_position=(0.0, 0.0, 0.05)))
    turned = reach.find_reach(with_franka(camera_position=(0.0, 0.0, 0.05), camera_rotation=(0.0, 0.0, 0.8)))
    assert not straight.beyond
    assert {pose[2] for pose in turned.beyond} == {CONFIG.workspace.theta[1]}
    hand = np.eye(4)
    hand[:2, :2] = [[math.cos(0.8), math.sin(0.8)], [-math.sin(0.8), math.cos(0.8)]]
    assert not reach.find_reach(with_franka(camera_position=(0.0, 0.0, 0.05), camera_rotation=(0, 0, 0.8)), hand).beyond


def test_a_joint_close_to_its_limit_is_a_warning():
    assert reach.check_reach(reach.Reach((), 0.01, 7, (0.4, 0.0, 2.0))).level is Level.WARNING


def test_packages_that_are_absent_are_named_with_what_brings_them():
    needed = {"torch": "make install", "franka_msgs": "apt-get install ros-noetic-franka-ros"}
    assert computer.check_packages(needed, []).level is Level.OK
    finding = computer.check_packages(needed, ["franka_msgs"])
    assert finding.level is Level.MISSING
    assert "franka_msgs" in finding.found
    assert "ros-noetic-franka-ros" in finding.mend


def test_a_disk_without_room_is_told(tmp_path):
    assert computer.check_disk(tmp_path / "sessions", CONFIG).level is Level.OK
    large = replace(
        CONFIG, exploration=replace(CONFIG.exploration, steps=1000000), camera=replace(CONFIG.camera, width=4096)
    )
    assert computer.check_disk(tmp_path, large).level is Level.MISSING


@pytest.mark.parametrize(
    ("wanted", "cuda", "level"),
    [
        ("auto", False, "OK"),
        ("auto", True, "OK"),
        ("cpu", True, "OK"),
        ("cuda", True, "OK"),
        ("cuda", False, "MISSING"),
    ],
)
def test_a_device_that_is_asked_for_has_to_be_there(wanted, cuda, level):
    assert computer.check_device(wanted, cuda, 2).level.value == level


@pytest.mark.parametrize(
    ("simulated", "published", "which", "level"),
    [
        (True, True, "pybullet", "OK"),
        (True, False, "pybullet", "MISSING"),
        (False, False, "pybullet", "MISSING"),
        (False, False, "franka", "OK"),
        (True, False, "franka", "MISSING"),
        (False, True, "franka", "WARNING"),
    ],
)
def test_each_robot_has_its_own_kind_of_time(simulated, published, which, level):
    assert computer.check_clock(simulated, published, which).level.value == level


HERE = Peer("/trainer", "10.77.0.2", "", local=True)
THERE = Peer("/franka_arm", "10.77.0.1", "", local=False)


@pytest.mark.parametrize(
    ("own", "loopback", "environment", "master_is_local", "peers", "expected"),
    [
        ("vm", False, {}, True, [HERE], ["OK", "OK"]),
        ("localhost", True, {"ROS_HOSTNAME": "localhost"}, True, [HERE], ["OK", "OK"]),
        ("10.77.0.2", False, {"ROS_IP": "10.77.0.2"}, False, [HERE, THERE], ["OK", "OK"]),
        ("localhost", True, {"ROS_HOSTNAME": "localhost"}, True, [HERE, THERE], ["MISSING", "OK"]),
        ("127.0.0.1", True, {"ROS_IP": "127.0.0.1"}, False, [], ["MISSING", "OK"]),
        ("vm", False, {}, False, [THERE], ["WARNING", "OK"]),
        ("vm", False, {"ROS_IP": "10.77.0.2", "ROS_HOSTNAME": "vm"}, True, [HERE], ["WARNING", "OK"]),
        ("vm", False, {}, True, [HERE._replace(trouble="Connection refused")], ["OK", "MISSING"]),
    ],
)
def test_addresses_that_others_cannot_use_are_told(own, loopback, environment, master_is_local, peers, expected):
    assert levels(computer.check_addresses(own, loopback, environment, master_is_local, peers)) == expected


def test_a_node_that_cannot_be_reached_is_named():
    peers = [HERE, THERE._replace(trouble="Name or service not known")]
    finding = computer.check_addresses("10.77.0.2", False, {"ROS_IP": "10.77.0.2"}, False, peers)[-1]
    assert finding.found == "cannot be reached from here: /franka_arm at 10.77.0.1 (Name or service not known)"


def test_what_an_earlier_launch_has_left_is_told_with_the_way_out():
    assert levels(computer.check_left_over({"/failure": "", "/franka_arm/stopped_by": ""})) == ["OK"]
    findings = computer.check_left_over({"/failure": "/trainer: disk full", "/franka_arm/stopped_by": "an operator"})
    assert levels(findings) == ["WARNING", "WARNING"]
    assert "/arm/recover" in findings[1].mend


def test_services_that_nobody_offers_are_named():
    assert computer.check_services(["/arm/move", "/x"], ["/arm/move"], "start it", "services", "why").level is Level.OK
    finding = computer.check_services(["/x"], ["/arm/move"], "start it", "services", "why")
    assert finding.found == "nobody offers /arm/move"
