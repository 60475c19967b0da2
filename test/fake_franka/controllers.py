"""controller_manager of franka_control: loaded and running controllers and their conflicts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Callable, Dict, Iterable, List, Mapping, Optional, Tuple

JOINTS = tuple(f"panda_joint{number}" for number in range(1, 8))
IMPEDANCE_TYPE = "franka_example_controllers/CartesianImpedanceExampleController"
STATE_TYPE = "franka_control/FrankaStateController"
INITIALIZED, RUNNING, STOPPED = "initialized", "running", "stopped"
BEST_EFFORT, STRICT = 1, 2

_EFFORT = "hardware_interface::EffortJointInterface"
_POSITION = "hardware_interface::PositionJointInterface"
_VELOCITY = "hardware_interface::VelocityJointInterface"
_CARTESIAN_VELOCITY = "franka_hw::FrankaVelocityCartesianInterface"
_STATE = ("franka_hw::FrankaStateInterface", ())

Claims = Tuple[Tuple[str, Tuple[str, ...]], ...]
"""Each hardware interface with the resources claimed through it."""

TYPES: Dict[str, Claims] = {
    STATE_TYPE: (_STATE,),
    IMPEDANCE_TYPE: (("franka_hw::FrankaModelInterface", ()), (_EFFORT, JOINTS), _STATE),
    "franka_example_controllers/JointPositionExampleController": ((_POSITION, JOINTS),),
    "franka_example_controllers/JointVelocityExampleController": ((_VELOCITY, JOINTS), _STATE),
    "franka_example_controllers/CartesianVelocityExampleController": (
        (_CARTESIAN_VELOCITY, ("panda_robot",)),
        _STATE,
    ),
    "position_controllers/JointTrajectoryController": ((_POSITION, JOINTS),),
    "effort_controllers/JointTrajectoryController": ((_EFFORT, JOINTS),),
}
"""Claims of the known controller types."""

DEFAULT_CONTROLLERS: Dict[str, Dict[str, Any]] = {
    "franka_state_controller": {"type": STATE_TYPE, "publish_rate": 30, "joint_names": list(JOINTS), "arm_id": "panda"},
    "position_joint_trajectory_controller": {
        "type": "position_controllers/JointTrajectoryController",
        "joints": list(JOINTS),
    },
    "effort_joint_trajectory_controller": {
        "type": "effort_controllers/JointTrajectoryController",
        "joints": list(JOINTS),
    },
}
"""Parameters that franka_control.launch sets."""


class ControllerError(Exception):
    """The controller manager rejected a request; the message is the one it logs."""


@dataclass
class Controller:
    """A loaded controller."""

    name: str
    type: str
    state: str = INITIALIZED

    @property
    def claims(self) -> Claims:
        """Claims while it runs."""
        return TYPES[self.type]

    @property
    def moves_the_arm(self) -> bool:
        """Whether it claims any resource."""
        return any(resources for _, resources in self.claims)


class ControllerManager:
    """Loads, unloads and switches controllers; not thread-safe."""

    def __init__(self, parameters: Callable[[str], Optional[Mapping[str, Any]]]) -> None:
        """parameters: returns a controller's parameters."""
        self._parameters = parameters
        self._loaded: Dict[str, Controller] = {}

    @property
    def loaded(self) -> List[Controller]:
        """All loaded controllers in the order of loading."""
        return list(self._loaded.values())

    @property
    def moving(self) -> List[str]:
        """Names of the running controllers that move the arm."""
        return [one.name for one in self.loaded if one.state == RUNNING and one.moves_the_arm]

    def runs(self, kind: str) -> bool:
        """Whether a controller of a type is running."""
        return any(one.state == RUNNING and one.type == kind for one in self.loaded)

    def load(self, name: str) -> Controller:
        """Load a controller. Raises ControllerError, for instance without its parameters."""
        if name in self._loaded:
            raise ControllerError(f"A controller named '{name}' was already loaded inside the controller manager")
        values = self._parameters(name) or {}
        if "type" not in values:
            raise ControllerError(
                f"Could not load controller '{name}' because the type was not specified. "
                f"Did you load the controller configuration on the parameter server (namespace: '/{name}')?"
            )
        if values["type"] not in TYPES:
            raise ControllerError(
                f"Could not load controller '{name}' because controller type '{values['type']}' does not exist."
            )
        controller = Controller(name, values["type"])
        if controller.type == IMPEDANCE_TYPE:
            _check_impedance(values)
        self._loaded[name] = controller
        return controller

    def unload(self, name: str) -> Controller:
        """Unload a controller that does not run. Raises ControllerError."""
        if name not in self._loaded:
            raise ControllerError(
                f"Could not unload controller with name '{name}' because no controller with this name exists"
            )
        if self._loaded[name].state == RUNNING:
            raise ControllerError(f"Could not unload controller with name '{name}' because it is still running")
        return self._loaded.pop(name)

    def switch(self, start: Iterable[str], stop: Iterable[str], strictness: int) -> bool:
        """Stop and start controllers, under STRICT all or none -> whether a controller that moves the arm is affected.

        Raises ControllerError, with nothing changed.
        """
        strict = strictness == STRICT
        stopping = self._chosen(stop, "stop", strict)
        starting = self._chosen(start, "start", strict)
        for one in list(stopping):
            if one.state != RUNNING:
                if strict:
                    raise ControllerError(f"Could not stop controller '{one.name}' since it is not running")
                stopping.remove(one)
        for one in list(starting):
            if one.state == RUNNING and one not in stopping:
                if strict:
                    raise ControllerError(f"Controller '{one.name}' is already running")
                starting.remove(one)
        after = [one for one in self.loaded if one in starting or (one.state == RUNNING and one not in stopping)]
        check_conflicts(after)
        for one in stopping:
            one.state = STOPPED
        for one in starting:
            one.state = RUNNING
        return any(one.moves_the_arm for one in (*stopping, *starting))

    def _chosen(self, names: Iterable[str], verb: str, strict: bool) -> List[Controller]:
        chosen = []
        for name in names:
            if name in self._loaded:
                chosen.append(self._loaded[name])
            elif strict:
                raise ControllerError(
                    f"Could not {verb} controller with name '{name}' because no controller with this name exists"
                )
        return chosen


def check_conflicts(controllers: Iterable[Controller]) -> None:
    """Check for conflicts as FrankaHW does: a joint may be claimed twice if exactly one claim is for its torque.

    So an effort controller and a position controller may run together. Raises ControllerError.
    """
    interfaces: Dict[str, List[str]] = {}
    for controller in controllers:
        for interface, resources in controller.claims:
            for resource in resources:
                interfaces.setdefault(resource, []).append(interface)
    kinds = {interface for claimed in interfaces.values() for interface in claimed}
    conflict = _CARTESIAN_VELOCITY in kinds and bool(kinds & {_POSITION, _VELOCITY})
    for claimed in interfaces.values():
        conflict |= len(claimed) > 2 or (len(claimed) == 2 and claimed.count(_EFFORT) != 1)
    if conflict:
        raise ControllerError("Could not switch controllers, due to resource conflict")


def _check_impedance(values: Mapping[str, Any]) -> None:
    if not isinstance(values.get("arm_id"), str):
        raise ControllerError("CartesianImpedanceExampleController: Could not read parameter arm_id")
    if len(values.get("joint_names", ())) != len(JOINTS):
        raise ControllerError(
            "CartesianImpedanceExampleController: Invalid or no joint_names parameters provided, "
            "aborting controller init!"
        )
