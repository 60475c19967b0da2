"""Everything that is said to franka_ros and heard from it: the one module that needs franka_msgs."""

from __future__ import annotations

from typing import Any, Callable, Dict, List, Tuple

import actionlib
import rospy
from actionlib_msgs.msg import GoalStatus
from controller_manager_msgs.srv import ListControllers, LoadController, SwitchController, UnloadController
from franka_msgs.msg import ErrorRecoveryAction, ErrorRecoveryGoal, Errors, FrankaState
from franka_msgs.srv import SetFullCollisionBehavior, SetLoad
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from std_msgs.msg import Header

from embodied_active_learning.config import FrankaConfig
from embodied_active_learning.errors import RobotError
from embodied_active_learning.franka.mount import CameraMount, CameraPose, quaternion
from embodied_active_learning.franka.readiness import CONTROLLER, Controller
from embodied_active_learning.ros import names
from embodied_active_learning.ros.runtime.services import TRANSPORT_ERRORS, log_service_wait

_RECOVERY_TIMEOUT = 20.0  # s of wall time
_CANCEL_TIMEOUT = 1.0  # s of wall time for which a recovery that takes too long is waited for when it was called off
_SWITCH_TIMEOUT = 5.0  # s that controller_manager may take to switch
# Interfaces of ros_control by which a controller only looks at the robot.
_LOOKING = ("JointStateInterface", "FrankaStateInterface", "FrankaModelInterface")


class FrankaInterface:
    """Set-points, states, controllers, collision behaviour and recovery. Calls raise RobotError."""

    def __init__(self, mount: CameraMount, update_state: Callable[[FrankaState], None]) -> None:
        """update_state is called with each state as it comes, in a thread of rospy's."""
        self._mount = mount
        self._set_points = rospy.Publisher(names.FRANKA_SET_POINT, PoseStamped, queue_size=1, tcp_nodelay=True)
        self._recovery = actionlib.SimpleActionClient(names.FRANKA_RECOVERY, ErrorRecoveryAction)
        self._subscriber = rospy.Subscriber(
            names.FRANKA_STATES, FrankaState, update_state, queue_size=1, tcp_nodelay=True
        )

    @property
    def is_heard(self) -> bool:
        """Whether anybody subscribes to the set-points."""
        return self._set_points.get_num_connections() > 0

    def send(self, set_point: CameraPose) -> None:
        """Have the impedance controller draw the camera to a pose."""
        position, rotation = self._mount.end_effector(set_point)
        header = Header(stamp=rospy.Time.now(), frame_id=names.BASE_FRAME)
        pose = Pose(Point(*position.tolist()), Quaternion(*quaternion(rotation)))
        self._set_points.publish(PoseStamped(header, pose))

    def rivals(self) -> List[str]:
        """Names of other nodes that publish set-points, as far as the master knows."""
        topic = rospy.resolve_name(names.FRANKA_SET_POINT)
        try:
            _, _, (publishers, _, _) = rospy.get_master().getSystemState()
        except OSError as error:  # MasterWatch says it aloud
            rospy.logdebug("the ROS master did not answer: %s", error)
            return []
        return [node for name, nodes in publishers if name == topic for node in nodes if node != rospy.get_name()]

    def controllers(self) -> Dict[str, Controller]:
        """Every controller that is loaded, by name."""
        return controllers_of(_call(names.CONTROLLERS, ListControllers))

    def load(self) -> None:
        """Load our controller."""
        if not _call(names.CONTROLLER_LOAD, LoadController, CONTROLLER).ok:
            raise RobotError(
                f"controller_manager cannot load {CONTROLLER}: its log tells why; launch/robot.launch puts its "
                "parameters on the server, and it is in ros-noetic-franka-example-controllers"
            )

    def unload(self) -> None:
        """Unload our controller, which is stopped."""
        if not _call(names.CONTROLLER_UNLOAD, UnloadController, CONTROLLER).ok:
            raise RobotError(f"controller_manager does not unload {CONTROLLER}: its log tells why")

    def start(self) -> None:
        """Start our controller; it begins where the arm is."""
        self._switch([CONTROLLER], [], "start")

    def stop(self) -> None:
        """Stop our controller; the robot holds the arm by itself then."""
        self._switch([], [CONTROLLER], "stop")

    def set_collision_behaviour(self, config: FrankaConfig) -> None:
        """Torques and forces beyond which a reflex stops the arm; no controller may move it meanwhile."""
        torques, forces = list(config.torque_limits), list(config.force_limits)
        answer = _call(
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
        _require(names.FRANKA_COLLISION, answer)

    def set_load(self, config: FrankaConfig) -> None:
        """What the flange carries; no controller may move the arm meanwhile."""
        xx, yy, zz = config.load_inertia
        inertia = [xx, 0.0, 0.0, 0.0, yy, 0.0, 0.0, 0.0, zz]
        answer = _call(
            names.FRANKA_LOAD,
            SetLoad,
            mass=config.load_mass,
            F_x_center_load=list(config.load_centre),
            load_inertia=inertia,
        )
        _require(names.FRANKA_LOAD, answer)

    def recover(self) -> None:
        """Have the robot recover from its errors; franka_control then starts the controllers anew that were running."""
        if not self._recovery.wait_for_server(rospy.Duration(_SWITCH_TIMEOUT)):
            raise RobotError(f"{rospy.resolve_name(names.FRANKA_RECOVERY)} is not offered: is franka_control running?")
        with log_service_wait(rospy.resolve_name(names.FRANKA_RECOVERY)):
            state = self._recovery.send_goal_and_wait(
                ErrorRecoveryGoal(), rospy.Duration(_RECOVERY_TIMEOUT), rospy.Duration(_CANCEL_TIMEOUT)
            )
        if state == GoalStatus.SUCCEEDED:
            return
        is_over = state not in (GoalStatus.PENDING, GoalStatus.ACTIVE)
        text = self._recovery.get_goal_status_text() if is_over else f"it did not end within {_RECOVERY_TIMEOUT:g} s"
        raise RobotError(f"the robot did not recover: {text}")

    @staticmethod
    def _switch(start: List[str], stop: List[str], what: str) -> None:
        answer = _call(
            names.CONTROLLER_SWITCH,
            SwitchController,
            start_controllers=start,
            stop_controllers=stop,
            strictness=SwitchController._request_class.STRICT,
            start_asap=False,
            timeout=0.0,
        )
        if not answer.ok:
            raise RobotError(f"controller_manager does not {what} {CONTROLLER}: its log tells why")


def error_names(errors: Errors) -> Tuple[str, ...]:
    """The names of the errors that are set."""
    return tuple(name for name in errors.__slots__ if getattr(errors, name))


def set_stiffness_parameters(config: FrankaConfig) -> bool:
    """Put the stiffness where our controller looks for it when it is loaded -> whether it was another one before."""
    changed = False
    wanted = {"translational_stiffness": config.stiffness, "rotational_stiffness": config.turn_stiffness}
    for key, value in wanted.items():
        name = f"{names.FRANKA_COMPLIANCE}/{key}"
        if rospy.get_param(name, None) != value:
            rospy.set_param(name, value)
            changed = True
    return changed


def controllers_of(answer: Any) -> Dict[str, Controller]:
    """The controllers in an answer of controller_manager, by name."""
    return {one.name: Controller(one.state, _moves(one)) for one in answer.controller}


def _moves(controller: Any) -> bool:
    """Whether a controller claims anything by which it could move the robot."""
    return any(
        claim.resources and not claim.hardware_interface.endswith(_LOOKING) for claim in controller.claimed_resources
    )


def _call(name: str, service_class: Any, *arguments: Any, **fields: Any) -> Any:
    resolved = rospy.resolve_name(name)
    try:
        with log_service_wait(resolved):
            rospy.wait_for_service(resolved, timeout=_SWITCH_TIMEOUT)
            return rospy.ServiceProxy(resolved, service_class)(*arguments, **fields)
    except TRANSPORT_ERRORS as error:
        raise RobotError(f"{resolved} did not answer: {error}; is franka_control running?") from error


def _require(name: str, answer: Any) -> None:
    if not answer.success:
        raise RobotError(
            f"{rospy.resolve_name(name)} was refused: {answer.error or 'no reason is given'}; see to the values of "
            "franka/, and that no controller moves the robot, then call /arm/recover"
        )
