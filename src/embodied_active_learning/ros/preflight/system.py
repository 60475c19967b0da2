"""The pre-flight checks of a running system: what was seen, handed to the checks of the library."""

from __future__ import annotations

import math
import os
from typing import Any, Dict, List, Optional, Tuple

import numpy as np
import rosgraph
import rospy
import tf2_ros
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from embodied_active_learning.config import REAL, SIMULATED, Config
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.msg import PlanarState
from embodied_active_learning.ros import names
from embodied_active_learning.ros.camera.image_buffer import FUTURE_TOLERANCE
from embodied_active_learning.ros.conversions import image_array, state_arrays
from embodied_active_learning.ros.preflight import computer, image, reach, robot, topics
from embodied_active_learning.ros.preflight.check_result import CheckResult, fine, missing
from embodied_active_learning.ros.preflight.ros_graph import (
    TfMonitor,
    TopicMonitor,
    is_local,
    is_loopback,
    listen,
    look_at_graph,
    look_for_peers,
)

try:
    from embodied_active_learning.ros.arm import franka_interface as franka_link

    MISSING = ""
except ImportError as error:
    franka_link, MISSING = None, error.name or str(error)

SERVICES = (names.ARM_MOVE, names.ARM_GO_TO, names.ARM_HEARTBEAT, names.ARM_STOP, names.ARM_RECOVER)
LEFT_OVER = (
    names.FAILURE_PARAMETER,
    "pybullet_arm/stopped_by",
    "franka_arm/stopped_by",
    "ergodic_planner/paused_by",
    "fingerprinter/has_paused_planner",
)
"""Parameters that launch files begin with empty."""
SERVICE_PATIENCE = 3.0
"""Wall seconds within which controller_manager is there."""
_STARTS = {
    SIMULATED: "roslaunch embodied_active_learning learn.launch stay:=true",
    REAL: "roslaunch embodied_active_learning robot.launch robot_ip:=...",
}


class System:
    """A running system as one node sees and hears it for some seconds of wall time. Nothing in it is changed."""

    def __init__(self, config: Config, seconds: float) -> None:
        self._config = config
        self._real = config.arm.robot == REAL
        self._start = _STARTS[REAL if self._real else SIMULATED]
        self._graph = look_at_graph()
        self._ears = {key: TopicMonitor(name, kind, self._graph) for key, (name, kind) in self._topics().items()}
        self._frames = TfMonitor()
        listen([*self._ears.values(), self._frames], seconds, once=not self._real)
        self._streams = {key: ear.close() for key, ear in self._ears.items()}

    def _topics(self) -> Dict[str, Tuple[str, Any]]:
        topics: Dict[str, Tuple[str, Any]] = {
            "state": (names.ARM_STATE, PlanarState),
            "image": (names.CAMERA_IMAGE, Image),
            "info": (names.CAMERA_INFO, CameraInfo),
        }
        if not self._real:
            return topics
        compressed = rospy.get_param("camera_pipeline/transport", "raw") == "compressed"
        source = (names.USB_CAM_COMPRESSED, CompressedImage) if compressed else (names.USB_CAM_IMAGE, Image)
        topics["source"] = source
        if franka_link is not None:
            topics["robot"] = (names.FRANKA_STATES, franka_link.FrankaState)
        return topics

    def clock(self) -> CheckResult:
        """Whose time it is."""
        published = bool(self._graph.publishers.get(rospy.resolve_name("clock")))
        return computer.check_clock(bool(rospy.get_param("/use_sim_time", False)), published, self._config.arm.robot)

    def addresses(self) -> List[CheckResult]:
        """This computer's address, and those of all nodes."""
        own = rosgraph.network.get_host_name()
        master, _ = rosgraph.network.parse_http_host_and_port(rosgraph.get_master_uri())
        peers = look_for_peers(self._graph.nodes)
        return computer.check_addresses(own, is_loopback(own), os.environ, is_local(master), peers)

    def left_over(self) -> List[CheckResult]:
        """What an earlier launch, or an operator, has left with the master."""
        values = {rospy.resolve_name(name): rospy.get_param(rospy.resolve_name(name), "") for name in LEFT_OVER}
        return computer.check_left_over(values)

    def robot_state(self) -> List[CheckResult]:
        """What franka_ros says of the robot."""
        if "robot" not in self._streams:
            return [_unreadable("robot state", names.FRANKA_STATES)]
        limits = topics.Limits(self._config.franka.state_max_age, FUTURE_TOLERANCE)
        why = "franka_arm knows by it where the arm is, and whether it may move"
        finding = topics.check_stream("robot state", self._streams["robot"], why, self._start, limits)
        newest = self._newest("robot")
        if newest is None:
            return [finding]
        errors = franka_link.error_names(newest.current_errors)
        return [
            finding,
            *robot.check_robot_state(newest.robot_mode, errors, newest.control_command_success_rate),
        ]

    def controllers(self) -> List[CheckResult]:
        """What controller_manager runs, and whether reflexes can be recovered from."""
        return [*self._controllers(), self._recovery()]

    def _controllers(self) -> List[CheckResult]:
        if franka_link is None:
            return [_unreadable("controllers", names.CONTROLLERS)]
        name = rospy.resolve_name(names.CONTROLLERS)
        try:
            rospy.wait_for_service(name, SERVICE_PATIENCE)
            answer = rospy.ServiceProxy(name, franka_link.ListControllers)()
        except (rospy.ROSException, rospy.ServiceException) as error:
            why = "franka_arm moves the arm by a controller that it loads and starts there"
            return [missing("controllers", f"{name} does not answer: {error}", why, self._start)]
        set_points_from = self._graph.publishers.get(rospy.resolve_name(names.FRANKA_SET_POINT), [])
        return robot.check_controllers(franka_link.controllers_of(answer), set_points_from)

    def _recovery(self) -> CheckResult:
        topic = f"{rospy.resolve_name(names.FRANKA_RECOVERY)}/status"
        return computer.check_services(
            list(self._graph.publishers), [topic], self._start, "error recovery", "reflexes are recovered from by it"
        )

    def arm_state(self) -> CheckResult:
        """What the node in front of the arm says of it."""
        why = "an image is of use only with the pose from which it was taken"
        return topics.check_stream("arm state", self._streams["state"], why, self._start, self._limits())

    def services(self) -> CheckResult:
        """What the arm is moved by."""
        needed = [rospy.resolve_name(name) for name in SERVICES]
        why = "planner and fingerprinter move the arm by them"
        return computer.check_services(list(self._graph.services), needed, self._start, "services", why)

    def source(self) -> CheckResult:
        """What the camera's driver publishes."""
        why = "camera_pipeline makes the model's images of it"
        start = f"{self._start}; rosrun usb_cam usb_cam_node, and see that its device is the camera"
        finding = topics.check_stream("camera", self._streams["source"], why, start, self._limits())
        newest = self._newest("source")
        if newest is None:
            return finding
        kind = f"{newest.width} x {newest.height} {newest.encoding}" if isinstance(newest, Image) else newest.format
        return finding.with_more(kind)

    def images(self) -> List[CheckResult]:
        """What the model gets to see."""
        start = "start camera_pipeline, and see what it says" if self._real else self._start
        why = "the model learns from these images"
        finding = topics.check_stream("images", self._streams["image"], why, start, self._limits())
        messages = list(self._ears["image"].messages)
        if not messages:
            return [finding]
        camera = self._config.camera
        try:
            arrays = [image_array(message, camera.height, camera.width) for message in messages]
        except ObservationError as error:
            return [finding, missing("picture", str(error), why, start)]
        return [finding, *image.check_picture(arrays, camera, self._real)]

    def camera_matrix(self) -> CheckResult:
        """What the camera's geometry is said to be."""
        newest = self._newest("info")
        if newest is None:
            why = "whoever measures in images needs it"
            return topics.check_stream("camera matrix", self._streams["info"], why, self._start, None)
        return image.check_camera_matrix(newest.K, newest.height, newest.width, self._config.camera)

    def frames(self) -> List[CheckResult]:
        """Where tf has the camera, and whether motion can begin there."""
        states = list(self._ears["state"].messages)
        try:
            pose, state = self._frames.camera_at(states)
        except tf2_ros.TransformException as error:
            if not self._real and self._graph.publishers.get(rospy.resolve_name("tf")):
                # A simulated arm that stands still has told its joints, and tf its frames, before this node came.
                return [fine("frames", "tf is published while the arm moves")]
            return [
                missing(
                    "frames",
                    f"tf does not lead from {names.BASE_FRAME} to {names.CAMERA_FRAME}: {error}",
                    "rviz, rosbag and calibration tools go by tf",
                    "start robot_state_publisher; of a real robot franka_state_controller publishes panda_EE, and "
                    "camera_pipeline the camera mount",
                )
            ]
        theta = math.atan2(pose[1, 0], pose[0, 0])
        findings = [robot.check_place(pose[:3, 3], pose[:3, 2], theta, self._config)]
        if state is not None:
            findings.insert(0, robot.check_frames((pose[0, 3], pose[1, 3], theta), state_arrays(state)[0]))
        elif states:
            findings.insert(
                0,
                missing(
                    "frames",
                    "tf has no pose of the camera at the stamps of arm/state",
                    "images are placed by tf in rviz",
                    "synchronise the computers' clocks; see that joint states are published",
                ),
            )
        return findings

    def reach(self) -> CheckResult:
        """Whether all of the workspace can be reached."""
        newest = self._newest("robot")
        hand = None if newest is None else np.reshape(newest.F_T_EE, (4, 4)).T
        finding = reach.check_reach(reach.find_reach(self._config, hand))
        if self._real and hand is None:
            return finding.with_more("with the flange for an end effector, as F_T_EE is not known")
        return finding

    def _limits(self) -> Optional[topics.Limits]:
        return topics.Limits(self._config.camera.max_age, FUTURE_TOLERANCE) if self._real else None

    def _newest(self, key: str) -> Any:
        messages = self._ears[key].messages if key in self._ears else ()
        return messages[-1] if messages else None


def _unreadable(about: str, name: str) -> CheckResult:
    return missing(
        about,
        f"{rospy.resolve_name(name)} cannot be read: {MISSING} is not installed here",
        "franka_arm cannot read it either",
        "apt-get install ros-noetic-franka-ros; or run preflight on the robot's computer",
    )
