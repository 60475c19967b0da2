"""Interface to franka_ros: set-points, states, controllers, settings and recovery; the only user of franka_msgs."""

from __future__ import annotations

import math
from typing import Any, Callable, Dict, List, Optional, Tuple

import actionlib
import rospy
from actionlib_msgs.msg import GoalStatus
from controller_manager_msgs.srv import ListControllers, LoadController, SwitchController
from dynamic_reconfigure.msg import Config as ReconfigureConfig
from dynamic_reconfigure.msg import DoubleParameter
from dynamic_reconfigure.srv import Reconfigure
from franka_msgs.msg import ErrorRecoveryAction, ErrorRecoveryGoal, Errors, FrankaState
from franka_msgs.srv import SetFullCollisionBehavior, SetLoad
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from std_msgs.msg import Header

from embodied_active_learning.config import FrankaConfig
from embodied_active_learning.errors import RobotError, ServiceError
from embodied_active_learning.franka.mount import CameraMount, CameraPose
from embodied_active_learning.franka.report import CONTROLLER, Controller
from embodied_active_learning.geometry import quaternion
from embodied_active_learning.ros import names
from embodied_active_learning.ros.runtime.master import CALL_ERRORS, master_proxy
from embodied_active_learning.ros.runtime.services import is_advertised, log_service_wait
from embodied_active_learning.ros.runtime.timed_service import call_within

_RECOVERY_TIMEOUT = 20.0  # s of wall time
_CANCEL_TIMEOUT = 1.0  # s of wall time that a cancelled recovery may take to end
_SERVER_TIMEOUT = 5.0  # s of wall time
_CALL_TIMEOUT = 10.0  # s of wall time: loading or switching a controller may take several
_LIST_TIMEOUT = 2.0  # s of wall time: less than readiness.CONTROL_TIMEOUT
_STIFFNESS_TOLERANCE = 1e-6  # N/m, Nm/rad
# Interfaces of ros_control through which a controller cannot move the robot.
_READ_ONLY = ("JointStateInterface", "FrankaStateInterface", "FrankaModelInterface")


class FrankaInterface:
    """Topics, services and actions of franka_ros. Calls raise RobotError."""

    def __init__(self, mount: CameraMount, on_state: Callable[[FrankaState], None]) -> None:
        """on_state is called with each state as it arrives, in a thread of rospy."""
        self._mount = mount
        self._on_state = on_state
        self._load_mass: Optional[float] = None
        self._other_publishers: List[str] = []
        self._set_points = rospy.Publisher(names.FRANKA_SET_POINT, PoseStamped, queue_size=1, tcp_nodelay=True)
        self._recovery = actionlib.SimpleActionClient(names.FRANKA_RECOVERY, ErrorRecoveryAction)
        self._subscriber = rospy.Subscriber(
            names.FRANKA_STATES, FrankaState, self._receive, queue_size=1, tcp_nodelay=True
        )

    @property
    def has_subscriber(self) -> bool:
        """Whether a node subscribes to the set-points."""
        return self._set_points.get_num_connections() > 0

    def send(self, set_point: CameraPose) -> None:
        """Publish a camera pose as the set-point of the impedance controller."""
        position, rotation = self._mount.end_effector(set_point)
        header = Header(stamp=rospy.Time.now(), frame_id=names.FRAMES.base)
        pose = Pose(Point(*position.tolist()), Quaternion(*quaternion(rotation)))
        self._set_points.publish(PoseStamped(header, pose))

    def other_publishers(self) -> List[str]:
        """Return the names of other nodes that publish set-points, as last known to the master."""
        topic = rospy.resolve_name(names.FRANKA_SET_POINT)
        try:
            _, _, (publishers, _, _) = master_proxy().getSystemState(rospy.get_name())
        except CALL_ERRORS as error:
            # Connections outlive the master: those that were known may still send.
            rospy.logdebug("no response from the ROS master: %s", error)
            return self._other_publishers
        self._other_publishers = [
            node for name, nodes in publishers if name == topic for node in nodes if node != rospy.get_name()
        ]
        return self._other_publishers

    def controllers(self) -> Dict[str, Controller]:
        """Return the loaded controllers by name."""
        return list_controllers()

    def load(self) -> None:
        """Load our controller."""
        if not _call(names.CONTROLLER_LOAD, LoadController, CONTROLLER).ok:
            raise RobotError(
                f"controller_manager cannot load {CONTROLLER}: see its log; its parameters are set by "
                "launch/robot.launch, and ros-noetic-franka-example-controllers has to be installed"
            )

    def start(self) -> None:
        """Start our controller, which holds the arm where it is."""
        self._switch([CONTROLLER], [], "start")

    def stop(self) -> None:
        """Stop our controller; the robot then holds the arm itself."""
        self._switch([], [CONTROLLER], "stop")

    def set_collision_behaviour(self, config: FrankaConfig) -> None:
        """Set the torques and forces above which a reflex stops the arm. No controller may move it meanwhile."""
        torques, forces = list(config.torque_limits), list(config.force_limits)
        response = _call(
            names.FRANKA_COLLISION,
            SetFullCollisionBehavior,
            lower_torque_thresholds_acceleration=torques,
            upper_torque_thresholds_acceleration=torques,
            lower_torque_thresholds_nominal=torques,
            upper_torque_thresholds_nominal=torques,
            lower_force_thresholds_acceleration=forces,
            upper_force_thresholds_acceleration=forces,
            lower_force_thresholds_nominal=forces,
            upper_force_thresholds_nominal=forces,
        )
        _require(names.FRANKA_COLLISION, response)

    def set_load(self, config: FrankaConfig) -> None:
        """Set the flange's load; a mass of 0 clears one that was set earlier. No controller may move the arm meanwhile.

        The end effector that Desk knows is not affected.
        """
        if config.load_mass == 0.0 and self._load_mass == 0.0:
            return
        xx, yy, zz = config.load_inertia
        response = _call(
            names.FRANKA_LOAD,
            SetLoad,
            mass=config.load_mass,
            F_x_center_load=list(config.load_centre),
            load_inertia=[xx, 0.0, 0.0, 0.0, yy, 0.0, 0.0, 0.0, zz],
        )
        _require(names.FRANKA_LOAD, response)

    def set_stiffness(self, config: FrankaConfig) -> None:
        """Set the stiffness of our loaded controller and verify the values that it has adopted."""
        wanted = {"translational_stiffness": config.stiffness, "rotational_stiffness": config.turn_stiffness}
        service = _stiffness_service()
        request = ReconfigureConfig(doubles=[DoubleParameter(name, value) for name, value in wanted.items()])
        response = _call(service, Reconfigure, request)
        adopted = {item.name: item.value for item in response.config.doubles}
        for name, value in wanted.items():
            if abs(adopted.get(name, math.inf) - value) > _STIFFNESS_TOLERANCE:
                raise RobotError(
                    f"{CONTROLLER} did not adopt {name} {value:g}: it uses {adopted.get(name)}; choose a value within "
                    f"the controller's range, then call {rospy.resolve_name(names.ARM_RECOVER)}"
                )

    def recover(self) -> None:
        """Recover the robot from its errors; franka_control then restarts the running controllers."""
        action = rospy.resolve_name(names.FRANKA_RECOVERY)
        if not self._recovery.wait_for_server(rospy.Duration(_SERVER_TIMEOUT)):
            raise RobotError(f"{action} is not available: is franka_control running?")
        with log_service_wait(action):
            state = self._recovery.send_goal_and_wait(
                ErrorRecoveryGoal(), rospy.Duration(_RECOVERY_TIMEOUT), rospy.Duration(_CANCEL_TIMEOUT)
            )
        if state == GoalStatus.SUCCEEDED:
            return
        is_over = state not in (GoalStatus.PENDING, GoalStatus.ACTIVE)
        text = self._recovery.get_goal_status_text() if is_over else f"it did not end within {_RECOVERY_TIMEOUT:g} s"
        raise RobotError(f"recovery failed: {text}")

    def _receive(self, state: FrankaState) -> None:
        self._load_mass = state.m_load
        self._on_state(state)

    @staticmethod
    def _switch(start: List[str], stop: List[str], what: str) -> None:
        response = _call(
            names.CONTROLLER_SWITCH,
            SwitchController,
            start_controllers=start,
            stop_controllers=stop,
            strictness=SwitchController._request_class.STRICT,
            start_asap=False,
            timeout=0.0,
        )
        if not response.ok:
            raise RobotError(f"controller_manager did not {what} {CONTROLLER}: see its log")


def error_names(errors: Errors) -> Tuple[str, ...]:
    """Return the names of the errors that are set."""
    return tuple(name for name in errors.__slots__ if getattr(errors, name))


def _stiffness_service() -> str:
    """Return the service that sets the stiffness, by its name in the installed version of franka_ros."""
    for name in names.FRANKA_STIFFNESS:
        if is_advertised(name):
            return name
    known = " nor ".join(map(rospy.resolve_name, names.FRANKA_STIFFNESS))
    raise RobotError(f"the stiffness cannot be set: neither {known} is available; franka_ros 0.8 or newer is required")


def list_controllers() -> Dict[str, Controller]:
    """Return the controllers of controller_manager by name. Raises RobotError if it does not respond."""
    response = _call(names.CONTROLLERS, ListControllers)
    return {one.name: Controller(one.state, _moves(one)) for one in response.controller}


def _moves(controller: Any) -> bool:
    """Whether a controller claims a resource through which it can move the robot."""
    return any(
        claim.resources and not claim.hardware_interface.endswith(_READ_ONLY) for claim in controller.claimed_resources
    )


def _call(name: str, service_class: Any, *arguments: Any, **fields: Any) -> Any:
    timeout = _LIST_TIMEOUT if name == names.CONTROLLERS else _CALL_TIMEOUT
    try:
        return call_within(timeout, name, service_class, service_class._request_class(*arguments, **fields))
    except ServiceError as error:
        raise RobotError(f"{error}; is franka_control running?") from error


def _require(name: str, response: Any) -> None:
    if not response.success:
        raise RobotError(
            f"{rospy.resolve_name(name)} rejected: {response.error or 'no reason given'}; check the values of franka/ "
            f"and that no controller moves the robot, then call {rospy.resolve_name(names.ARM_RECOVER)}"
        )
