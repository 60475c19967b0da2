"""The robot description for rviz, robot_state_publisher and PyBullet."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import unquote, urlparse
from xml.etree import ElementTree as ET

import pytest

from embodied_active_learning.simulation.panda import (
    ARM_JOINTS,
    BASE_FRAME,
    CAMERA_FRAME,
    FLANGE_FRAME,
    OPTICAL_FRAME,
    joint_limits,
    panda_urdf,
    physics_urdf,
)


@pytest.fixture(params=[panda_urdf, physics_urdf])
def robot(request):
    return ET.fromstring(request.param())


def test_meshes_are_existing_absolute_files():
    meshes = list(ET.fromstring(panda_urdf()).iter("mesh"))
    assert len(meshes) == 8  # visual meshes only
    for mesh in meshes:
        address = urlparse(mesh.get("filename"))
        assert address.scheme == "file"
        assert Path(unquote(address.path)).is_file()


def test_links_form_one_tree(robot):
    links = {link.get("name") for link in robot.iter("link")}
    parent_of = {joint.find("child").get("link"): joint.find("parent").get("link") for joint in robot.findall("joint")}
    assert len(parent_of) == len(robot.findall("joint"))
    assert links - set(parent_of) == {BASE_FRAME}
    assert set(parent_of.values()) <= links


def test_camera_is_fixed_to_flange_without_offset(robot):
    joints = {joint.find("child").get("link"): joint for joint in robot.findall("joint")}
    for child, parent in ((CAMERA_FRAME, FLANGE_FRAME), (OPTICAL_FRAME, CAMERA_FRAME)):
        assert joints[child].get("type") == "fixed"
        assert joints[child].find("parent").get("link") == parent
        assert joints[child].find("origin").attrib == {"xyz": "0 0 0", "rpy": "0 0 0"}


def test_seven_joints_and_no_gripper(robot):
    moving = {joint.get("name") for joint in robot.findall("joint") if joint.get("type") != "fixed"}
    assert moving == set(ARM_JOINTS)


def test_joint_limits_are_those_of_the_real_robot():
    for limits in (joint_limits(panda_urdf()), joint_limits(physics_urdf())):
        assert limits[0] == (-2.8973, 2.8973, 2.175)
        assert limits[3] == (-3.0718, -0.0698, 2.175)
        assert limits[6] == (-2.8973, 2.8973, 2.61)


def test_links_have_mass_and_fixed_joints_no_axis(robot):
    assert all(float(mass.get("value")) > 0.0 for mass in robot.iter("mass"))
    assert all(joint.find("axis") is None for joint in robot.findall("joint") if joint.get("type") == "fixed")
