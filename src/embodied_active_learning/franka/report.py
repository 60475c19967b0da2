"""What franka_ros reports about the robot: modes, controllers, errors, and the condition that follows from them."""

from __future__ import annotations

import enum
from typing import Mapping, NamedTuple, Optional, Sequence, Tuple

CONTROLLER = "cartesian_impedance_example_controller"
"""The controller of franka_example_controllers that follows the set-points."""


class RobotMode(enum.IntEnum):
    """franka_msgs/FrankaState.robot_mode."""

    OTHER = 0
    IDLE = 1
    MOVE = 2
    GUIDING = 3
    REFLEX = 4
    USER_STOPPED = 5
    AUTOMATIC_ERROR_RECOVERY = 6


class Condition(enum.Enum):
    """Whether the robot can be moved, and what prevents it; set-points are sent only if it is READY."""

    NO_STATE = "no state yet"
    STALE = "stale states"
    UNUSABLE = "unusable states"
    USER_STOPPED = "user stop"
    GUIDED = "guided by hand"
    RECOVERY_REQUIRED = "held until recovery"
    RECOVERING = "recovering"
    REFLEX = "reflex"
    NO_CONTROLLER_MANAGER = "no controller_manager"
    OTHER_CONTROLLER = "another controller"
    OTHER_PUBLISHER = "another node's set-points"
    UNPREPARED = "not prepared"
    NO_SUBSCRIBER = "no subscriber to set-points"
    STARTING = "starting"
    OUTDATED_CONTROL = "outdated list of controllers"
    NO_SET_POINTS = "no set-points"
    READY = "ready"


class Controller(NamedTuple):
    """A controller of controller_manager: its state, and whether it claims an interface that moves the robot."""

    state: str  # initialized | running | stopped
    moves: bool

    @property
    def is_active(self) -> bool:
        """Whether it moves the robot now."""
        return self.moves and self.state == "running"


class Report(NamedTuple):
    """The latest information about the robot; ages in seconds of wall time."""

    age: Optional[float] = None  # since a new state arrived
    delay: float = 0.0  # of that state's stamp behind this computer's clock at arrival; negative if ahead
    problem: str = ""  # why that state is unusable
    mode: int = RobotMode.OTHER
    errors: Tuple[str, ...] = ()  # names of the present errors
    last_errors: Tuple[str, ...] = ()  # names of those that ended the last motion
    controllers: Optional[Mapping[str, Controller]] = None  # by name; None while controller_manager does not respond
    publishers: Sequence[str] = ()  # other nodes that publish set-points
    has_subscriber: bool = True  # whether any node subscribes to our set-points
    control_age: float = 0.0  # since the three above were requested
    tick_age: float = 0.0  # since the thread that sends set-points has last computed one

    @property
    def error_names(self) -> str:
        """The present errors, or else those that ended the last motion."""
        return ", ".join(self.errors or self.last_errors) or "no error reported"

    @property
    def mode_name(self) -> str:
        """The robot's mode."""
        known = {mode.value: mode.name.lower().replace("_", " ") for mode in RobotMode}
        return known.get(self.mode, f"unknown ({self.mode})")

    @property
    def running_controllers(self) -> str:
        """Names of the running controllers."""
        names = [name for name, one in (self.controllers or {}).items() if one.state == "running"]
        return ", ".join(names) or "none known"

    @property
    def is_controlled(self) -> bool:
        """Whether our controller is active."""
        ours = (self.controllers or {}).get(CONTROLLER)
        return ours is not None and ours.is_active

    @property
    def other_controllers(self) -> Tuple[str, ...]:
        """Names of active controllers other than ours."""
        return tuple(name for name, one in (self.controllers or {}).items() if one.is_active and name != CONTROLLER)

    @property
    def others(self) -> Tuple[str, ...]:
        """Names of what else may move the robot: other active controllers, and nodes that publish set-points."""
        return (*self.other_controllers, *self.publishers)
