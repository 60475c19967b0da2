"""The Franka Panda of pybullet_data as a URDF for robot_state_publisher, rviz and PyBullet."""

from __future__ import annotations

from pathlib import Path
from typing import Tuple
from xml.etree import ElementTree as ET

import pybullet_data

BASE_FRAME = "panda_link0"
FLANGE_FRAME = "panda_link8"
CAMERA_FRAME = "camera_link"
OPTICAL_FRAME = "camera_optical_frame"
ARM_JOINTS = tuple(f"panda_joint{number}" for number in range(1, 8))

_MESH_PREFIX = "package://meshes/"
# The camera replaces the gripper at the flange.
_GRIPPER_LINKS = ("panda_hand", "panda_leftfinger", "panda_rightfinger", "panda_grasptarget")
_SMALL_MASS = "0.01"
_SMALL_INERTIA = "1e-5"


def panda_urdf() -> str:
    """Return the URDF for robot_state_publisher and rviz: meshes as absolute file:// URLs, camera frames at the flange.

    With the tool pointing down, the optical frame's z points to the table, its x is the flange's x, and its
    orientation in panda_link0 is Rz(theta) Rx(pi).
    """
    robot = _camera_panda()
    # Nothing collides here, and rviz reports errors on the materials of these meshes.
    for link in robot.iter("link"):
        for shape in link.findall("collision"):
            link.remove(shape)
    meshes = _panda_folder() / "meshes"
    for mesh in robot.iter("mesh"):
        mesh.set("filename", (meshes / mesh.get("filename", "")[len(_MESH_PREFIX) :]).as_uri())
    # robot_state_publisher (KDL) warns about a root link with inertia.
    base = _link(robot, BASE_FRAME)
    base.remove(_child(base, "inertial"))
    return _text(robot)


def physics_urdf() -> str:
    """Return the URDF for PyBullet: the same joints and masses without shapes, as nothing touches or sees the arm."""
    robot = _camera_panda()
    for link in robot.iter("link"):
        for shape in link.findall("visual") + link.findall("collision") + link.findall("contact"):
            link.remove(shape)
    return _text(robot)


def _panda_folder() -> Path:
    return Path(pybullet_data.getDataPath()) / "franka_panda"


def _text(robot: ET.Element) -> str:
    return '<?xml version="1.0"?>\n' + ET.tostring(robot, encoding="unicode")


def _camera_panda() -> ET.Element:
    """Return the Panda with a camera instead of a gripper, the real robot's joint limits and valid inertias."""
    # The file is part of pybullet and as trusted as its code.
    robot = ET.parse(_panda_folder() / "panda.urdf").getroot()  # noqa: S314
    _remove_gripper(robot)
    for joint in robot.iter("joint"):
        _tidy_joint(joint)
    for link in robot.iter("link"):
        _tidy_inertia(link)
    _add_frame(robot, FLANGE_FRAME, CAMERA_FRAME)
    _add_frame(robot, CAMERA_FRAME, OPTICAL_FRAME)
    _add_camera_body(robot)
    return robot


def _remove_gripper(robot: ET.Element) -> None:
    joints = [joint for joint in robot.iter("joint") if _child(joint, "child").get("link") in _GRIPPER_LINKS]
    for element in joints + [_link(robot, name) for name in _GRIPPER_LINKS]:
        robot.remove(element)


def _add_camera_body(robot: ET.Element) -> None:
    """Add a webcam body behind the optical centre, for display."""
    visual = ET.SubElement(_link(robot, CAMERA_FRAME), "visual")
    ET.SubElement(visual, "origin", {"xyz": "0 0 -0.0125", "rpy": "0 0 0"})
    ET.SubElement(ET.SubElement(visual, "geometry"), "box", {"size": "0.09 0.03 0.025"})
    material = ET.SubElement(visual, "material", {"name": "camera_black"})
    ET.SubElement(material, "color", {"rgba": "0.1 0.1 0.12 1"})


def _tidy_joint(joint: ET.Element) -> None:
    """Set the real robot's limits, given as soft limits in pybullet_data; remove the axes of fixed joints."""
    soft, limit, axis = joint.find("safety_controller"), joint.find("limit"), joint.find("axis")
    if soft is not None and limit is not None:
        limit.set("lower", soft.get("soft_lower_limit", ""))
        limit.set("upper", soft.get("soft_upper_limit", ""))
    if axis is not None and joint.get("type") == "fixed":
        joint.remove(axis)


def _tidy_inertia(link: ET.Element) -> None:
    """Give massless links a negligible mass, which the dynamics engine needs."""
    if float(_child(_child(link, "inertial"), "mass").get("value", "")) == 0.0:
        link.remove(_child(link, "inertial"))
        link.insert(0, _small_inertial())


def _small_inertial() -> ET.Element:
    inertial = ET.Element("inertial")
    ET.SubElement(inertial, "origin", {"xyz": "0 0 0", "rpy": "0 0 0"})
    ET.SubElement(inertial, "mass", {"value": _SMALL_MASS})
    diagonal = {"ixx": _SMALL_INERTIA, "iyy": _SMALL_INERTIA, "izz": _SMALL_INERTIA}
    ET.SubElement(inertial, "inertia", {**diagonal, "ixy": "0", "ixz": "0", "iyz": "0"})
    return inertial


def _add_frame(robot: ET.Element, parent: str, name: str) -> None:
    """Add a link fixed to its parent without offset; its centre of mass is its origin."""
    ET.SubElement(robot, "link", {"name": name}).append(_small_inertial())
    joint = ET.SubElement(robot, "joint", {"name": f"{name}_joint", "type": "fixed"})
    ET.SubElement(joint, "parent", {"link": parent})
    ET.SubElement(joint, "child", {"link": name})
    ET.SubElement(joint, "origin", {"xyz": "0 0 0", "rpy": "0 0 0"})


def _link(robot: ET.Element, name: str) -> ET.Element:
    return next(link for link in robot.iter("link") if link.get("name") == name)


def _child(element: ET.Element, tag: str) -> ET.Element:
    child = element.find(tag)
    if child is None:
        raise ValueError(f"{element.tag} {element.get('name')} of pybullet_data's Panda has no {tag}")
    return child


def joint_limits(urdf: str) -> Tuple[Tuple[float, float, float], ...]:
    """Return lower limit [rad], upper limit [rad] and top speed [rad/s] of the seven arm joints in a URDF."""
    robot = ET.fromstring(urdf)  # noqa: S314 -- made by this module
    limits = {joint.get("name"): joint.find("limit") for joint in robot.iter("joint")}
    found = (limits[name] for name in ARM_JOINTS)
    return tuple(
        (float(limit.get("lower", "")), float(limit.get("upper", "")), float(limit.get("velocity", "")))
        for limit in found
        if limit is not None
    )
