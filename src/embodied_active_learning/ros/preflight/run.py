"""The preflight checks in order, with a line for each result."""

from __future__ import annotations

import importlib.util
import os
import shutil
import sys
from typing import Any, Callable, List, Optional, Sequence, Tuple, Union

import rosgraph
import rospy

from embodied_active_learning.config import (
    FRANKA,
    REAL_ROBOTS,
    RECORDED,
    Config,
    find_profile,
    load_profile,
    merge,
)
from embodied_active_learning.errors import CommandError
from embodied_active_learning.hardware_config import arm_of
from embodied_active_learning.ros import names
from embodied_active_learning.ros.arm.config_check import require_matching_config
from embodied_active_learning.ros.preflight import computer
from embodied_active_learning.ros.preflight.check_result import CheckResult, Level, error, most_severe, ok, summary
from embodied_active_learning.ros.preflight.system import System
from embodied_active_learning.ros.runtime.master import connection_error
from embodied_active_learning.ros.runtime.node import arm_config_values
from embodied_active_learning.session.session import session_root
from embodied_active_learning.simulation.resources import PACKAGE, package_folder

_COMMON_PACKAGES = dict.fromkeys(("torch", "cv2", "sklearn", "pybullet", "tf2_ros"), "make install")
"""Python packages of all nodes that may be missing, and the command that installs each."""
_READ_MESSAGE = "read the message"


class PreflightReport:
    """Writes each result as a line, and collects them."""

    def __init__(self, write: Callable[[str], None]) -> None:
        self._write = write
        self.results: List[CheckResult] = []

    def add(self, result: CheckResult) -> None:
        """Write and keep a result."""
        self._write(result.describe())
        self.results.append(result)

    def run(self, name: str, check: Callable[[], Union[CheckResult, Sequence[CheckResult]]]) -> None:
        """Add the results of a check; an exception in it becomes an error, and the next checks still run."""
        try:
            results = check()
        except Exception as problem:
            results = error(name, f"check failed: {problem!r}", "the state of this part is unknown", _READ_MESSAGE)
        for result in [results] if isinstance(results, CheckResult) else results:
            self.add(result)


def run(arguments: List[str], robot_profile: str, seconds: float, write: Callable[[str], None]) -> Level:
    """Run all checks; write their results and a summary, and return the level of the most severe one.

    Args:
        arguments: command line, for rospy.
        robot_profile: name or path of a robot profile, for a real robot without a running launch file.
        seconds: how long topics are observed.
        write: called with each line.
    """
    report = PreflightReport(write)
    uri = rosgraph.get_master_uri()
    problem = connection_error(uri)
    if problem:
        report.add(
            error(
                "master",
                f"no response of {uri}: {problem}",
                "topics, services and parameters cannot be checked",
                "start robot.launch; set ROS_MASTER_URI to the robot's computer on every computer",
            )
        )
    else:
        report.add(ok("master", f"{uri} responds"))
        # Clock and frames of the system in this namespace; without a namespace these change nothing.
        remappings = ["/clock:=clock", "/tf:=tf", "/tf_static:=tf_static"]
        rospy.init_node("preflight", argv=[*arguments, *remappings], anonymous=True)
    config = None
    try:
        config, results = find_config(robot_profile, has_master=not problem)
        for result in results:
            report.add(result)
    except Exception as invalid:
        report.add(error("configuration", str(invalid), "no node starts with it", _READ_MESSAGE))
    if config is not None:
        if config.arm.robot in REAL_ROBOTS:
            names.FRAMES.use_robot(config.franka.arm_id, config.franka.table_height)
        check_computer(report, config)
        if not problem:
            check_system(report, config, seconds)
    write(summary(report.results))
    return most_severe(report.results)


def find_config(robot_profile: str, has_master: bool) -> Tuple[Config, List[CheckResult]]:
    """Return the configuration of the arm if it has its own, else of the system, else of the profiles.

    Raises ConfigError.
    """
    name, arm_name = _resolve(names.CONFIG_PARAMETER), _resolve(names.ARM_CONFIG_PARAMETER)
    values, arm_values = (rospy.get_param(name, None), arm_config_values()) if has_master else (None, None)
    if arm_values is not None:
        config = Config.from_dict(arm_values)
        result = ok("configuration", f"parameter {arm_name}, arm/robot {config.arm.robot}")
        return config, [result] if values is None else [result, check_match(config, values)]
    system_config = None if values is None else Config.from_dict(values)
    if system_config is not None and system_config.arm.robot != RECORDED:
        return system_config, [ok("configuration", f"parameter {name}, arm/robot {system_config.arm.robot}")]
    folder = package_folder(PACKAGE) / "config"
    profile = load_profile(find_profile("default", folder))
    if robot_profile:
        profile = merge(profile, {"arm": {"robot": FRANKA}})  # unless the robot profile names another robot
        profile = merge(profile, load_profile(find_profile(robot_profile, folder)))
    state = "is not set" if system_config is None else "belongs to a replay, which has no arm"
    result = error(
        "configuration",
        f"parameter {name} {state}; checking with {robot_profile or 'the default profile of a simulated arm'}",
        "the nodes read it from this parameter",
        "start robot.launch or learn.launch with the same ROS_NAMESPACE, or give --robot-profile",
    )
    return Config.from_dict(profile), [result]


def check_match(config: Config, values: Any) -> CheckResult:
    """Check that the configuration of the system, on the parameter server, matches that of the arm."""
    try:
        require_matching_config(config, values)
    except CommandError as mismatch:
        return error(
            "config check",
            str(mismatch),
            "the arm rejects all commands",
            "start both sides with the same profiles; if no system is running, rosparam delete "
            f"{_resolve(names.CONFIG_PARAMETER)}",
        )
    return ok("config check", "the configurations of system and arm match")


def check_computer(report: PreflightReport, config: Config) -> None:
    """Run the checks that need no master."""
    required = {**_COMMON_PACKAGES, **arm_of(config.arm.robot).packages}
    missing = [name for name in required if importlib.util.find_spec(name) is None]
    device, cores = config.training.device, len(os.sched_getaffinity(0))
    path_python = shutil.which("python3") or ""
    prefix = os.path.realpath(os.path.dirname(os.path.dirname(path_python)))  # the link itself names the environment
    report.run("python", lambda: computer.check_interpreter(os.path.realpath(sys.prefix), prefix))
    report.run("packages", lambda: computer.check_packages(required, missing))
    report.run("disk", lambda: computer.check_disk(session_root(config), config))
    report.run("device", lambda: computer.check_device(device, *find_gpu(device), cores))


def check_system(report: PreflightReport, config: Config, seconds: float) -> None:
    """Run the checks of a running system."""
    system: Optional[System] = None
    try:
        system = System(config, seconds)
    except Exception as problem:
        reason = "none of its parts can be checked"
        report.add(error("system", f"cannot be observed: {problem!r}", reason, _READ_MESSAGE))
        return
    real = config.arm.robot in REAL_ROBOTS
    report.run("clock", system.clock)
    report.run("addresses", system.addresses)
    report.run("persistent parameters", system.persistent_parameters)
    if config.arm.robot == FRANKA:
        report.run("robot state", system.robot_state)
        report.run("controllers", system.controllers)
    report.run("arm state", system.arm_state)
    report.run("services", system.services)
    if real:
        report.run("camera", system.camera)
        report.run("camera controls", system.camera_controls)
    report.run("images", system.images)
    report.run("camera matrix", system.camera_matrix)
    report.run("frames", system.frames)
    report.run("reach", system.reach)


def find_gpu(device: str) -> Tuple[bool, str]:
    """Return whether torch can compute on a GPU, and why not if there is one. Not asked if training/device is cpu."""
    if device == "cpu" or importlib.util.find_spec("torch") is None:
        return False, ""
    # Imported late, because the import takes seconds.
    import torch  # noqa: PLC0415

    from embodied_active_learning.model.build import check_device  # noqa: PLC0415

    if not torch.cuda.is_available():
        return False, ""
    try:
        check_device(torch.device("cuda"))
    except RuntimeError as problem:
        return False, f"the GPU cannot compute: {str(problem).splitlines()[0]}"
    return True, ""


def _resolve(name: str) -> str:
    return rosgraph.names.resolve_name(name, rosgraph.names.make_caller_id("preflight"))
