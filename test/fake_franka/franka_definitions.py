"""Messages, services and actions of franka_ros, ros_control and dynamic_reconfigure that our nodes use.

A description of their fields for computers without those packages. Two nodes are compatible if the checksums over the
types, names and order of the fields agree; test_fake_franka_messages.py compares them with those of the originals:
franka_msgs 0.10, controller_manager_msgs 0.19 and dynamic_reconfigure 1.7, as released for Noetic.
"""

from __future__ import annotations

from typing import Dict, List

_ERRORS = (
    "joint_position_limits_violation",
    "cartesian_position_limits_violation",
    "self_collision_avoidance_violation",
    "joint_velocity_violation",
    "cartesian_velocity_violation",
    "force_control_safety_violation",
    "joint_reflex",
    "cartesian_reflex",
    "max_goal_pose_deviation_violation",
    "max_path_pose_deviation_violation",
    "cartesian_velocity_profile_safety_violation",
    "joint_position_motion_generator_start_pose_invalid",
    "joint_motion_generator_position_limits_violation",
    "joint_motion_generator_velocity_limits_violation",
    "joint_motion_generator_velocity_discontinuity",
    "joint_motion_generator_acceleration_discontinuity",
    "cartesian_position_motion_generator_start_pose_invalid",
    "cartesian_motion_generator_elbow_limit_violation",
    "cartesian_motion_generator_velocity_limits_violation",
    "cartesian_motion_generator_velocity_discontinuity",
    "cartesian_motion_generator_acceleration_discontinuity",
    "cartesian_motion_generator_elbow_sign_inconsistent",
    "cartesian_motion_generator_start_elbow_invalid",
    "cartesian_motion_generator_joint_position_limits_violation",
    "cartesian_motion_generator_joint_velocity_limits_violation",
    "cartesian_motion_generator_joint_velocity_discontinuity",
    "cartesian_motion_generator_joint_acceleration_discontinuity",
    "cartesian_position_motion_generator_invalid_frame",
    "force_controller_desired_force_tolerance_violation",
    "controller_torque_discontinuity",
    "start_elbow_sign_inconsistent",
    "communication_constraints_violation",
    "power_limit_violation",
    "joint_p2p_insufficient_torque_for_planning",
    "tau_j_range_violation",
    "instability_detected",
    "joint_move_in_wrong_direction",
    "cartesian_spline_motion_generator_violation",
    "joint_via_motion_generator_planning_joint_limit_violation",
    "base_acceleration_initialization_timeout",
    "base_acceleration_invalid_reading",
)

_STATE = (
    ("std_msgs/Header", "header"),
    ("float64[6]", "cartesian_collision cartesian_contact"),
    ("float64[7]", "q q_d dq dq_d ddq_d theta dtheta tau_J dtau_J tau_J_d"),
    ("float64[6]", "K_F_ext_hat_K"),
    ("float64[2]", "elbow elbow_d elbow_c delbow_c ddelbow_c"),
    ("float64[7]", "joint_collision joint_contact"),
    ("float64[6]", "O_F_ext_hat_K O_dP_EE_d"),
    ("float64[3]", "O_ddP_O"),
    ("float64[6]", "O_dP_EE_c O_ddP_EE_c"),
    ("float64[7]", "tau_ext_hat_filtered"),
    ("float64", "m_ee"),
    ("float64[3]", "F_x_Cee"),
    ("float64[9]", "I_ee"),
    ("float64", "m_load"),
    ("float64[3]", "F_x_Cload"),
    ("float64[9]", "I_load"),
    ("float64", "m_total"),
    ("float64[3]", "F_x_Ctotal"),
    ("float64[9]", "I_total"),
    ("float64[16]", "O_T_EE O_T_EE_d O_T_EE_c F_T_EE F_T_NE NE_T_EE EE_T_K"),
    ("float64", "time control_command_success_rate"),
    ("uint8", "robot_mode"),
    ("franka_msgs/Errors", "current_errors last_motion_errors"),
)

_MODES = ("OTHER", "IDLE", "MOVE", "GUIDING", "REFLEX", "USER_STOPPED", "AUTOMATIC_ERROR_RECOVERY")

_ANSWER = "bool success\nstring error\n"


def _fields(*groups) -> str:
    """Return lines "type name" for groups (type, "name name ...")."""
    return "".join(f"{kind} {name}\n" for kind, names in groups for name in names.split())


def _service(request: str, response: str = _ANSWER) -> str:
    return f"{request}---\n{response}"


def _thresholds(*phases: str) -> str:
    """Return the collision thresholds of joints and hand, lower and upper, for each phase of a motion."""
    sizes = (("torque", 7), ("force", 6))
    return "".join(
        f"float64[{size}] {bound}_{kind}_thresholds_{phase}\n"
        for kind, size in sizes
        for phase in phases
        for bound in ("lower", "upper")
    )


_CONSTANTS = "".join(f"uint8 ROBOT_MODE_{name}={number}\n" for number, name in enumerate(_MODES))

MESSAGES: Dict[str, Dict[str, str]] = {
    "franka_msgs": {
        "Errors": _fields(("bool", " ".join(_ERRORS))),
        "FrankaState": _CONSTANTS + _fields(*_STATE),
    },
    "controller_manager_msgs": {
        "HardwareInterfaceResources": "string hardware_interface\nstring[] resources\n",
        "ControllerState": _fields(
            ("string", "name state type"),
            ("controller_manager_msgs/HardwareInterfaceResources[]", "claimed_resources"),
        ),
    },
    "dynamic_reconfigure": {
        "BoolParameter": "string name\nbool value\n",
        "IntParameter": "string name\nint32 value\n",
        "StrParameter": "string name\nstring value\n",
        "DoubleParameter": "string name\nfloat64 value\n",
        "GroupState": "string name\nbool state\nint32 id\nint32 parent\n",
        "Config": _fields(
            ("BoolParameter[]", "bools"),
            ("IntParameter[]", "ints"),
            ("StrParameter[]", "strs"),
            ("DoubleParameter[]", "doubles"),
            ("GroupState[]", "groups"),
        ),
    },
}
"""Definition of each message by package and name."""

SERVICES: Dict[str, Dict[str, str]] = {
    "franka_msgs": {
        "SetLoad": _service("float64 mass\nfloat64[3] F_x_center_load\nfloat64[9] load_inertia\n"),
        "SetFullCollisionBehavior": _service(_thresholds("acceleration", "nominal")),
    },
    "controller_manager_msgs": {
        "ListControllers": _service("", "controller_manager_msgs/ControllerState[] controller\n"),
        "LoadController": _service("string name\n", "bool ok\n"),
        "UnloadController": _service("string name\n", "bool ok\n"),
        "SwitchController": _service(
            "string[] start_controllers\nstring[] stop_controllers\nint32 strictness\n"
            "int32 BEST_EFFORT=1\nint32 STRICT=2\nbool start_asap\nfloat64 timeout\n",
            "bool ok\n",
        ),
    },
    "dynamic_reconfigure": {
        "Reconfigure": _service("Config config\n", "Config config\n"),
    },
}
"""Definition of each service by package and name."""

ACTIONS: Dict[str, Dict[str, List[str]]] = {"franka_msgs": {"ErrorRecovery": ["", "", ""]}}
"""Definitions of goal, result and feedback of each action by package and name."""


def action_messages(name: str, package: str, goal: str, result: str, feedback: str) -> Dict[str, str]:
    """Return the seven messages of an action."""
    status = "std_msgs/Header header\nactionlib_msgs/GoalStatus status\n"
    return {
        f"{name}Goal": goal,
        f"{name}Result": result,
        f"{name}Feedback": feedback,
        f"{name}ActionGoal": (f"std_msgs/Header header\nactionlib_msgs/GoalID goal_id\n{package}/{name}Goal goal\n"),
        f"{name}ActionResult": f"{status}{package}/{name}Result result\n",
        f"{name}ActionFeedback": f"{status}{package}/{name}Feedback feedback\n",
        f"{name}Action": _fields(
            (f"{package}/{name}ActionGoal", "action_goal"),
            (f"{package}/{name}ActionResult", "action_result"),
            (f"{package}/{name}ActionFeedback", "action_feedback"),
        ),
    }


def message_definitions(package: str) -> Dict[str, str]:
    """Return the definitions of all messages of a package by name, including those of its actions."""
    found = dict(MESSAGES[package])
    for name, parts in ACTIONS.get(package, {}).items():
        found.update(action_messages(name, package, *parts))
    return found
