"""The sections of the configuration that describe the hardware: workspace, camera, arm, simulation and real Panda."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Mapping, Tuple

from embodied_active_learning.schema import setting
from embodied_active_learning.workspace import STATE_NAMES, Workspace

SIMULATED, FRANKA, VELOCITY_SERVICE, RECORDED = "pybullet", "franka", "velocity_service", "recording"
_DIMENSIONS = len(STATE_NAMES)


@dataclass(frozen=True)
class Robot:
    """What the package needs to know about a robot, besides its node and its launch file. All are Pandas.

    Attributes:
        name: Value of arm/robot; its node is NAME_arm, in nodes/ and launch/.
        start: Command that starts its arm.
        profile: Robot profile in config/ that applies if none is given; only a real robot has one.
        packages: Python packages that only its nodes need, and the command that installs each.
        has_end_effector_frame: Whether its driver publishes the end effector's frame, to which the camera is attached.
    """

    name: str
    start: str
    profile: str = ""
    packages: Mapping[str, str] = field(default_factory=dict)
    has_end_effector_frame: bool = False

    @property
    def node(self) -> str:
        """Name of its node, and of the node's launch file."""
        return f"{self.name}_arm"


_LAUNCH = "roslaunch embodied_active_learning"
ARMS = {
    robot.name: robot
    for robot in (
        Robot(SIMULATED, f"{_LAUNCH} learn.launch stay:=true"),
        Robot(
            FRANKA,
            f"{_LAUNCH} robot.launch robot_ip:=...",
            "franka",
            {
                "actionlib": "apt-get install ros-noetic-actionlib",
                "franka_msgs": "apt-get install ros-noetic-franka-ros",
                "controller_manager_msgs": "apt-get install ros-noetic-controller-manager-msgs",
                "dynamic_reconfigure": "apt-get install ros-noetic-dynamic-reconfigure",
            },
            has_end_effector_frame=True,
        ),
        Robot(VELOCITY_SERVICE, f"{_LAUNCH} learn.launch robot:={VELOCITY_SERVICE} stay:=true", "franka"),
    )
}
"""The robots with an arm, by name."""
REAL_ROBOTS = tuple(robot.name for robot in ARMS.values() if robot.profile)
ROBOTS = (*ARMS, RECORDED)


def arm_of(name: str) -> Robot:
    """Return the robot with a name from ROBOTS; for recorded images the simulated one, which needs no hardware."""
    return ARMS.get(name, ARMS[SIMULATED])


@dataclass(frozen=True)
class WorkspaceConfig:
    """Limits of the camera's planar pose in the base frame."""

    x: Tuple[float, ...] = setting((0.325, 0.625), "limits of the camera's x", "m", -2.0, 2.0, length=2, fixed=True)
    y: Tuple[float, ...] = setting((-0.15, 0.15), "limits of the camera's y", "m", -2.0, 2.0, length=2, fixed=True)
    theta: Tuple[float, ...] = setting(
        (-2.0, 2.0), "limits of the camera's yaw", "rad", -math.pi, math.pi, length=2, fixed=True
    )

    def box(self) -> Workspace:
        """Return the limits as a Workspace. Raises ConfigError if a lower limit is not below the upper one."""
        lower, upper = zip(self.x, self.y, self.theta)
        return Workspace(lower=lower, upper=upper)


@dataclass(frozen=True)
class CameraConfig:
    """The wrist camera."""

    width: int = setting(180, "image width", "px", 8, 4096, fixed=True)
    height: int = setting(180, "image height", "px", 8, 4096, fixed=True)
    field_of_view: float = setting(30.0, "vertical field of view", "deg", 1.0, 150.0, fixed=True)
    distance: float = setting(0.3, "height of the camera above the table", "m", 0.05, 2.0, fixed=True)
    latency: float = setting(0.0, "time from the exposure of an image to its stamp", "s", 0.0, 0.5)
    max_age: float = setting(1.0, "hold the arm if the newest image or pose is older", "s", 0.05, 60.0)
    allow_featureless: bool = setting(False, "accept images of a single colour; otherwise they hold the arm")


@dataclass(frozen=True)
class ArmConfig:
    """The arm, and the motion limits that its node enforces on every command."""

    robot: str = setting(SIMULATED, "source of images and poses", choices=ROBOTS, fixed=True)
    max_speed: float = setting(0.15, "speed limit of the camera along x and along y", "m/s", 0.001, 1.0)
    max_turn_rate: float = setting(1.5, "yaw rate limit of the camera", "rad/s", 0.001, 2.6)
    # These accelerations on all axes at once take four fifths of the limit of a Panda's second joint (7.5 rad/s^2),
    # and less of the others', everywhere in the default workspace. Top speed is reached within 0.15 s.
    max_acceleration: float = setting(1.2, "acceleration limit along x and along y", "m/s^2", 0.1, 13.0)
    max_turn_acceleration: float = setting(10.0, "yaw acceleration limit", "rad/s^2", 0.1, 25.0)
    max_duration: float = setting(1.0, "longest duration of one velocity command", "s", 0.01, 10.0)
    commander_timeout: float = setting(
        5.0, "wall time without a heartbeat after which a commander loses control of the arm", "s", 0.1, 600.0
    )
    retries: int = setting(
        5, "consecutive failures of the arm that are tolerated, with increasing pauses, before giving up", "", 0, 100
    )


@dataclass(frozen=True)
class SimulationConfig:
    """The PyBullet simulation."""

    world: str = setting("diagonal", "name of a world in worlds/, or path of a YAML file", fixed=True)
    physics_rate: int = setting(240, "physics steps per second", "Hz", 60, 2000)
    start: Tuple[float, ...] = setting(
        (0.475, 0.0, 0.0), "initial pose: x, y, theta", "m, m, rad", -4.0, 4.0, length=_DIMENSIONS
    )


@dataclass(frozen=True)
class FrankaConfig:
    """A real Panda: mounting, contact limits and recovery."""

    arm_id: str = setting("panda", "prefix of the robot's frames and joints", choices=("panda", "fr3"))
    table_height: float = setting(0.0, "height of the table surface in the base frame", "m", -1.0, 1.0, fixed=True)
    camera_position: Tuple[float, ...] = setting(
        (0.0, 0.0, 0.0),
        "optical centre of the camera in the end effector frame (EE)",
        "m",
        -0.5,
        0.5,
        length=3,
        fixed=True,
    )
    camera_rotation: Tuple[float, ...] = setting(
        (0.0, 0.0, 0.0),
        "roll, pitch, yaw (fixed axes) of camera_optical_frame in the end effector frame",
        "rad",
        -math.pi,
        math.pi,
        length=3,
        fixed=True,
    )
    rate: float = setting(
        100.0,
        "set-points per second sent to the impedance controller, or velocity requests to a velocity service",
        "Hz",
        20.0,
        500.0,
    )
    max_lead: float = setting(0.05, "largest distance from measured pose to set-point along each axis", "m", 0.005, 0.1)
    max_turn_lead: float = setting(0.5, "largest yaw from measured pose to set-point", "rad", 0.02, 0.6)
    max_height_error: float = setting(0.03, "largest height error of the camera at the start of a move", "m", 1e-3, 0.2)
    max_tilt: float = setting(
        0.15, "largest angle of the optical axis from the vertical at the start of a move", "rad", 0.005, 0.5
    )
    max_outside: float = setting(
        0.1, "distance outside the workspace, along x or y, from which the arm still returns automatically", "m", 0, 1
    )
    max_turn_outside: float = setting(
        0.5, "yaw outside the workspace from which the arm still returns automatically", "rad", 0.0, math.pi
    )
    tolerance: float = setting(0.015, "position error at rest that counts as reached", "m", 0.001, 0.1)
    turn_tolerance: float = setting(0.1, "yaw error at rest that counts as reached", "rad", 0.005, 0.5)
    stiffness: float = setting(200.0, "translational stiffness of the impedance controller", "N/m", 50.0, 400.0)
    turn_stiffness: float = setting(30.0, "rotational stiffness of the impedance controller", "Nm/rad", 2.0, 30.0)
    state_max_age: float = setting(0.2, "hold the arm if the newest robot state is older", "s", 0.02, 2.0)
    coast: float = setting(0.2, "time after a move during which its velocity is kept before braking", "s", 0.0, 1.0)
    recoveries: int = setting(
        3, "consecutive reflexes that are recovered automatically; after more, /arm/recover is required", "", 0, 100
    )
    torque_limits: Tuple[float, ...] = setting(
        (20.0, 20.0, 18.0, 18.0, 16.0, 14.0, 12.0),
        "external joint torques that trigger a collision reflex",
        "Nm",
        1.0,
        100.0,
        length=7,
    )
    force_limits: Tuple[float, ...] = setting(
        (20.0, 20.0, 20.0, 25.0, 25.0, 25.0),
        "external force (3) and torque (3) at the end effector that trigger a collision reflex",
        "N, Nm",
        1.0,
        100.0,
        length=6,
    )
    load_mass: float = setting(
        0.0, "mass of camera and mount, unless set in Desk; 0 clears a load set earlier", "kg", 0.0, 3.0
    )
    load_centre: Tuple[float, ...] = setting(
        (0.0, 0.0, 0.0), "centre of mass of that load in the flange frame", "m", -0.5, 0.5, length=3
    )
    load_inertia: Tuple[float, ...] = setting(
        (0.0, 0.0, 0.0), "moments of inertia of that load: Ixx, Iyy, Izz", "kg m^2", 0.0, 1.0, length=3
    )
