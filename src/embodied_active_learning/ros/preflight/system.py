"""Checks of a running system: it is observed for some seconds, and nothing in it is changed."""

from __future__ import annotations

import os
from typing import Any, Dict, List, Optional, Tuple

import numpy as np
import rosgraph
import rospy
import tf2_ros
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from embodied_active_learning.config import FRANKA, REAL_ROBOTS, Config
from embodied_active_learning.errors import ObservationError, RobotError
from embodied_active_learning.hardware_config import ARMS, arm_of
from embodied_active_learning.msg import PlanarState
from embodied_active_learning.ros import names
from embodied_active_learning.ros.camera.image_buffer import FUTURE_TOLERANCE
from embodied_active_learning.ros.camera.v4l2 import differing_settings, read_controls, wanted_settings
from embodied_active_learning.ros.conversions import image_array, state_arrays
from embodied_active_learning.ros.preflight import computer, images, network, reach, robot
from embodied_active_learning.ros.preflight.check_result import CheckResult, error, ok, warning
from embodied_active_learning.ros.preflight.ros_graph import (
    TfMonitor,
    TopicMonitor,
    collect,
    find_peers,
    is_local,
    is_loopback,
    read_graph,
)
from embodied_active_learning.ros.preflight.topics import TopicLimits, check_topic

try:
    from embodied_active_learning.ros.arm import franka_interface
except ModuleNotFoundError as missing:
    if missing.name not in ARMS[FRANKA].packages:
        raise
    franka_interface = None  # type: ignore[assignment]

SERVICES = (names.ARM_MOVE, names.ARM_GO_TO, names.ARM_HEARTBEAT, names.ARM_STOP, names.ARM_RECOVER)
PARAMETERS = (
    names.FAILURE_PARAMETER,
    names.STOPPED_BY,
    names.HELD_FOR,
    names.PLANNER_PAUSED_BY,
    "fingerprinter/has_paused_planner",
)
"""Persistent parameters, in which an earlier launch may have left a stop, pause or failure."""


class System:
    """A running system as this node observes it. Each method checks one part."""

    def __init__(self, config: Config, seconds: float) -> None:
        """Observe topics and tf for `seconds` of wall time; less for a simulated arm, which may rest."""
        self._config = config
        self._real = config.arm.robot in REAL_ROBOTS
        self._start = arm_of(config.arm.robot).start
        self._graph = read_graph()
        self._topics = {key: TopicMonitor(*topic, self._graph) for key, topic in self._topic_types().items()}
        self._tf = TfMonitor()
        collect([*self._topics.values(), self._tf], seconds, stop_early=not self._real)
        self._statistics = {key: monitor.close() for key, monitor in self._topics.items()}

    def _topic_types(self) -> Dict[str, Tuple[str, Any]]:
        topics: Dict[str, Tuple[str, Any]] = {
            "state": (names.ARM_STATE, PlanarState),
            "image": (names.CAMERA_IMAGE, Image),
            "info": (names.CAMERA_INFO, CameraInfo),
        }
        if not self._real:
            return topics
        compressed = rospy.get_param("camera_pipeline/transport", "raw") == "compressed"
        topics["camera"] = (names.USB_CAM_COMPRESSED, CompressedImage) if compressed else (names.USB_CAM_IMAGE, Image)
        if self._config.arm.robot == FRANKA and franka_interface is not None:
            topics["robot"] = (names.FRANKA_STATES, franka_interface.FrankaState)
        return topics

    def clock(self) -> CheckResult:
        """Check the source of time."""
        published = bool(self._graph.publishers.get(rospy.resolve_name("clock")))
        return computer.check_clock(bool(rospy.get_param("/use_sim_time", False)), published, self._config.arm.robot)

    def addresses(self) -> List[CheckResult]:
        """Check the addresses of this computer and of all nodes."""
        host = rosgraph.network.get_host_name()
        own = network.OwnAddress(host, is_loopback(host), is_local(host), rosgraph.network.get_local_addresses())
        master, _ = rosgraph.network.parse_http_host_and_port(rosgraph.get_master_uri())
        peers = find_peers(self._graph.nodes)
        return [
            network.check_own_address(own, os.environ, is_local(master), peers),
            network.check_peers(peers),
        ]

    def persistent_parameters(self) -> List[CheckResult]:
        """Check the persistent parameters."""
        values = {rospy.resolve_name(name): rospy.get_param(rospy.resolve_name(name), "") for name in PARAMETERS}
        return computer.check_persistent_parameters(values)

    def robot_state(self) -> List[CheckResult]:
        """Check franka_states."""
        if "robot" not in self._statistics:
            return [_cannot_read("robot state", names.FRANKA_STATES)]
        limits = TopicLimits(self._config.franka.state_max_age, FUTURE_TOLERANCE)
        reason = "franka_arm needs the pose and the mode of the robot"
        result = check_topic("robot state", self._statistics["robot"], reason, self._start, limits)
        newest = self._newest("robot")
        if newest is None:
            return [result]
        errors = franka_interface.error_names(newest.current_errors)
        results = robot.check_robot_state(newest.robot_mode, errors, newest.control_command_success_rate)
        return [result, *results, robot.check_load(newest.m_load, self._config)]

    def controllers(self) -> List[CheckResult]:
        """Check the controllers and the action that recovers from reflexes."""
        topic = f"{rospy.resolve_name(names.FRANKA_RECOVERY)}/status"
        reason = "franka_arm recovers from reflexes with it"
        recovery = computer.check_advertised(
            list(self._graph.publishers), [topic], "error recovery", reason, self._start
        )
        return [*self._controllers(), recovery]

    def _controllers(self) -> List[CheckResult]:
        if franka_interface is None:
            return [_cannot_read("controllers", names.CONTROLLERS)]
        try:
            controllers = franka_interface.list_controllers()
        except RobotError as problem:
            reason = "franka_arm loads and starts its controller with this service"
            return [error("controllers", str(problem), reason, self._start)]
        publishers = self._graph.publishers.get(rospy.resolve_name(names.FRANKA_SET_POINT), [])
        return robot.check_controllers(controllers, publishers)

    def arm_state(self) -> CheckResult:
        """Check arm/state."""
        reason = "images are used only with the pose from which they were taken"
        return check_topic("arm state", self._statistics["state"], reason, self._start, self._limits())

    def services(self) -> CheckResult:
        """Check the services of the arm."""
        required = [rospy.resolve_name(name) for name in SERVICES]
        reason = "planner and fingerprinter move the arm with them"
        return computer.check_advertised(list(self._graph.services), required, "services", reason, self._start)

    def camera(self) -> CheckResult:
        """Check the images of the camera driver."""
        reason = "camera_pipeline needs the images of the camera driver"
        remedy = f"{self._start}; check the device of the camera driver (usb_cam)"
        result = check_topic("camera", self._statistics["camera"], reason, remedy, self._limits())
        newest = self._newest("camera")
        if newest is None:
            return result
        is_raw = isinstance(newest, Image)
        return result.with_detail(f"{newest.width} x {newest.height} {newest.encoding}" if is_raw else newest.format)

    def camera_controls(self) -> CheckResult:
        """Check the v4l2 controls of usb_cam's device, if it runs on this computer."""
        parameters = rospy.get_param("usb_cam", {})
        device, node = parameters.get("video_device", ""), rospy.resolve_name("usb_cam")
        peers = find_peers([node]) if device and node in self._graph.nodes else []
        if not any(peer.local for peer in peers):
            return ok("camera controls", "not checked: no usb_cam with a device runs on this computer")
        try:
            controls = read_controls(device)
        except RobotError as problem:
            return warning("camera controls", str(problem), "exposure and focus may not be fixed", "read the message")
        return robot.check_camera_controls(device, controls, differing_settings(controls, wanted_settings(parameters)))

    def images(self) -> List[CheckResult]:
        """Check the images of the model."""
        remedy = "start camera_pipeline, or see its log" if self._real else self._start
        reason = "the model learns from these images"
        result = check_topic("images", self._statistics["image"], reason, remedy, self._limits())
        messages = list(self._topics["image"].messages)
        if not messages:
            return [result]
        camera = self._config.camera
        try:
            arrays = [image_array(message, camera.height, camera.width) for message in messages]
        except ObservationError as problem:
            return [result, error("image content", str(problem), reason, remedy)]
        return [result, *images.check_content(arrays, camera, self._real)]

    def camera_matrix(self) -> CheckResult:
        """Check camera_info."""
        newest = self._newest("info")
        if newest is None:
            reason = "measurements in images need it"
            return check_topic("camera matrix", self._statistics["info"], reason, self._start, None)
        return images.check_camera_matrix(newest, self._config.camera)

    def frames(self) -> List[CheckResult]:
        """Check tf, and whether motion can start at the camera's pose."""
        states = list(self._topics["state"].messages)
        try:
            transform, state = self._tf.camera_pose(states)
        except tf2_ros.TransformException as problem:
            if not self._real and self._graph.publishers.get(rospy.resolve_name("tf")):
                return [ok("frames", "tf is published while the arm moves")]
            return [
                error(
                    "frames",
                    f"no transform from {names.FRAMES.base} to {names.CAMERA_FRAME}: {problem}",
                    "rviz, rosbag and calibration tools need tf",
                    f"start robot_state_publisher; franka_state_controller publishes {names.FRAMES.end_effector}, and "
                    "camera_pipeline the camera mount",
                )
            ]
        try:
            pose = robot.camera_pose(transform, self._config)
        except ObservationError as problem:
            return [error("camera pose", str(problem), "motion does not start there", "read the message")]
        results = [robot.check_camera_pose(pose, self._config)]
        if state is not None:
            results.insert(0, robot.check_frames(pose.planar, state_arrays(state)[0].tolist()))
        elif states:
            results.insert(
                0,
                error(
                    "frames",
                    "tf has no camera pose at the stamps of arm/state",
                    "rviz places images with tf",
                    "synchronise the clocks of the computers; check that joint states are published",
                ),
            )
        return results

    def reach(self) -> CheckResult:
        """Check that the arm reaches the workspace."""
        newest = self._newest("robot")
        end_effector = None if newest is None else np.reshape(newest.F_T_EE, (4, 4)).T
        result = reach.check_reach(reach.find_reach(self._config, end_effector))
        if self._real and end_effector is None:
            return result.with_detail("assuming the end effector at the flange, because F_T_EE is unknown")
        return result

    def _limits(self) -> Optional[TopicLimits]:
        return TopicLimits(self._config.camera.max_age, FUTURE_TOLERANCE) if self._real else None

    def _newest(self, key: str) -> Any:
        messages = self._topics[key].messages if key in self._topics else ()
        return messages[-1] if messages else None


def _cannot_read(name: str, topic: str) -> CheckResult:
    return error(
        name,
        f"{rospy.resolve_name(topic)} cannot be read: {', '.join(ARMS[FRANKA].packages)} are not all installed",
        "franka_arm cannot read it either",
        "apt-get install ros-noetic-franka-ros, or run preflight on the robot's computer",
    )
