"""Services of controller_manager, and the impedance controller's topic and stiffness server."""

from __future__ import annotations

import threading
from typing import Any, Callable, Dict, Optional

import rospy
from controller_manager_msgs.msg import ControllerState, HardwareInterfaceResources
from controller_manager_msgs.srv import (
    ListControllers,
    ListControllersResponse,
    LoadController,
    LoadControllerResponse,
    SwitchController,
    SwitchControllerResponse,
    UnloadController,
    UnloadControllerResponse,
)
from dynamic_reconfigure.msg import Config as ReconfigureConfig
from dynamic_reconfigure.msg import DoubleParameter
from dynamic_reconfigure.srv import Reconfigure, ReconfigureResponse
from geometry_msgs.msg import PoseStamped

from fake_franka.computer import Computer
from fake_franka.controllers import (
    DEFAULT_CONTROLLERS,
    IMPEDANCE_TYPE,
    STATE_TYPE,
    ControllerError,
    ControllerManager,
)
from fake_franka.impedance import normalised
from fake_franka.robot import FakeRobot

# name: default and largest value, N/m, Nm/rad, Nm/rad
STIFFNESS = {
    "translational_stiffness": (200.0, 400.0),
    "rotational_stiffness": (10.0, 30.0),
    "nullspace_stiffness": (0.5, 100.0),
}


class ImpedanceTopics:
    """Set-point topic and stiffness server of a loaded impedance controller."""

    def __init__(self, name: str, robot: FakeRobot, computer: Computer) -> None:
        self._robot = robot
        self._computer = computer
        # franka_ros 0.8.0 to 0.9.0 lacks the slash, and so also ignores parameters under the documented name.
        separator = "" if rospy.get_param("~old_stiffness_name", False) else "/"
        node = f"{name}{separator}dynamic_reconfigure_compliance_param_node"
        self._stiffness = {
            key: float(rospy.get_param(f"{node}/{key}", default)) for key, (default, _) in STIFFNESS.items()
        }
        self._updates = rospy.Publisher(f"{node}/parameter_updates", ReconfigureConfig, queue_size=1, latch=True)
        self._apply()
        self._service = computer.offer(f"{node}/set_parameters", Reconfigure, self.reconfigure)
        self._subscriber = rospy.Subscriber(
            f"{name}/equilibrium_pose", PoseStamped, self.take_set_point, queue_size=20, tcp_nodelay=True
        )

    def close(self) -> None:
        """Remove topic and server when the controller is unloaded."""
        self._subscriber.unregister()
        self._service.shutdown()
        self._updates.unregister()

    def take_set_point(self, message: PoseStamped) -> None:
        """Topic equilibrium_pose; its frame is ignored."""
        point, turn = message.pose.position, message.pose.orientation
        if self._computer.is_alive:
            orientation = normalised((turn.x, turn.y, turn.z, turn.w))
            self._robot.take_set_point((point.x, point.y, point.z), orientation)

    def reconfigure(self, request: Any) -> ReconfigureResponse:
        """Service set_parameters of dynamic_reconfigure: parameters that are not named keep their values."""
        ignored = rospy.get_param("~ignore_stiffness", False)
        for given in request.config.doubles:
            if given.name in STIFFNESS and not ignored:
                self._stiffness[given.name] = min(max(given.value, 0.0), STIFFNESS[given.name][1])
        return ReconfigureResponse(self._apply())

    def _apply(self) -> ReconfigureConfig:
        with self._robot.lock:
            translational, rotational, _ = self._stiffness.values()
            self._robot.hand.set_stiffness(translational, rotational)
        config = ReconfigureConfig(doubles=[DoubleParameter(*item) for item in self._stiffness.items()])
        self._updates.publish(config)
        return config


class ManagerServices:
    """Offers controller_manager/...; starts the controllers named by ~running."""

    def __init__(self, robot: FakeRobot, computer: Computer) -> None:
        self._robot = robot
        self._computer = computer
        self._lock = threading.Lock()
        self._impedance: Dict[str, ImpedanceTopics] = {}
        self.state_rate = 30.0
        """Hz of franka_state_controller."""
        for name, values in DEFAULT_CONTROLLERS.items():
            if not rospy.has_param(f"{name}/type"):
                rospy.set_param(name, values)
        self._start_manager()
        self._responds = threading.Event()
        self._responds.set()
        self._offer("list_controllers", ListControllers, self.list_controllers)
        self._offer("load_controller", LoadController, self.load)
        self._offer("unload_controller", UnloadController, self.unload)
        self._offer("switch_controller", SwitchController, self.switch)

    def hang(self, on: bool) -> None:
        """Respond to no request, as a controller_manager that waits for its control loop, or respond again."""
        (self._responds.clear if on else self._responds.set)()

    def _offer(self, name: str, kind: Any, answer: Callable[[Any], Any]) -> None:
        def answered(request: Any) -> Any:
            self._responds.wait()
            return answer(request)

        self._computer.offer(f"controller_manager/{name}", kind, answered)

    @property
    def publishes_states(self) -> bool:
        """Whether franka_state_controller is running."""
        with self._lock:
            return self._manager.runs(STATE_TYPE)

    def restart(self) -> None:
        """Unload all controllers and start those named by ~running, as a restarted franka_control does."""
        with self._lock:
            for topics in self._impedance.values():
                topics.close()
            self._impedance.clear()
            self._start_manager()

    def list_controllers(self, _request: Any) -> ListControllersResponse:
        """Service list_controllers."""
        with self._lock:
            return ListControllersResponse(
                [
                    ControllerState(
                        one.name,
                        one.state,
                        one.type,
                        [HardwareInterfaceResources(interface, list(claimed)) for interface, claimed in one.claims],
                    )
                    for one in self._manager.loaded
                ]
            )

    def load(self, request: Any) -> LoadControllerResponse:
        """Service load_controller."""
        return LoadControllerResponse(self._done(lambda: self._load(request.name)))

    def unload(self, request: Any) -> UnloadControllerResponse:
        """Service unload_controller."""
        return UnloadControllerResponse(self._done(lambda: self._unload(request.name)))

    def switch(self, request: Any) -> SwitchControllerResponse:
        """Service switch_controller."""
        start, stop, strictness = request.start_controllers, request.stop_controllers, request.strictness
        return SwitchControllerResponse(self._done(lambda: self._switch(start, stop, strictness)))

    def _done(self, action: Callable[[], None]) -> bool:
        with self._lock:
            try:
                action()
            except ControllerError as error:
                rospy.logerr("%s", error)
                return False
            return True

    def _start_manager(self) -> None:
        self._manager = ControllerManager(_parameters)
        for name in rospy.get_param("~running", ["franka_state_controller"]):
            self._load(name)
            self._switch([name], [], SwitchController._request_class.STRICT)

    def _load(self, name: str) -> None:
        controller = self._manager.load(name)
        if controller.type == STATE_TYPE:
            self.state_rate = float(rospy.get_param(f"{name}/publish_rate", 30.0))
        if controller.type == IMPEDANCE_TYPE:
            self._impedance[name] = ImpedanceTopics(name, self._robot, self._computer)

    def _unload(self, name: str) -> None:
        self._manager.unload(name)
        topics = self._impedance.pop(name, None)
        if topics is not None:
            topics.close()

    def _switch(self, start: Any, stop: Any, strictness: int) -> None:
        if self._manager.switch(start, stop, strictness):
            self._robot.change_controllers(bool(self._manager.moving), self._manager.runs(IMPEDANCE_TYPE))


def _parameters(name: str) -> Optional[Dict[str, Any]]:
    values = rospy.get_param(name, None)
    return values if isinstance(values, dict) else None
