"""Checks of this computer: Python, packages, disk, device, clock, parameters of an earlier launch."""

from __future__ import annotations

from pathlib import Path
from typing import List, Mapping, Sequence

import rospy

from embodied_active_learning.config import SIMULATED, Config
from embodied_active_learning.errors import SessionError
from embodied_active_learning.ros import names
from embodied_active_learning.ros.preflight.check_result import CheckResult, error, ok, warning
from embodied_active_learning.session.disk import check_space, estimate_bytes, free_bytes


def check_packages(required: Mapping[str, str], missing: Sequence[str]) -> CheckResult:
    """Check that the required Python packages can be imported. required: package -> command that installs it."""
    if not missing:
        return ok("packages", f"{len(required)} of {len(required)} can be imported")
    commands = "; ".join(dict.fromkeys(required[name] for name in missing))
    return error(
        "packages",
        f"cannot be imported: {', '.join(missing)}",
        "the nodes that need them do not start",
        f"{commands}; then source setup.bash again",
    )


def check_disk(root: Path, config: Config) -> CheckResult:
    """Check that the session folder has space for a run."""
    try:
        check_space(root, config)
        free = free_bytes(root)
    except SessionError as problem:
        return error("disk", str(problem), "every observation is stored", "free space or choose another session_root")
    return ok("disk", f"{free / 1e9:.0f} GB free in {root}; a run takes {estimate_bytes(config) / 1e9:.1f} GB")


def check_device(device: str, gpu: bool, problem: str, cores: int) -> CheckResult:
    """Check that torch can compute on the device of training/device.

    Args:
        device: auto, cpu or cuda.
        gpu: whether a GPU can be used.
        problem: why a GPU that exists cannot be used.
        cores: number of CPU cores.
    """
    cpu = f"CPU with {cores} cores (training/device {device})"
    if device == "cuda" and not gpu:
        return error(
            "device",
            f"training/device is cuda, but {problem or 'torch finds no CUDA device'}",
            "the trainer does not start",
            "set device:=auto, fix the GPU driver or torch, or run preflight on the computer of the trainer",
        )
    if problem:
        remedy = "install a build of torch for this GPU, or set device:=cpu"
        return warning("device", f"{cpu}: {problem}", "training is slower on the CPU", remedy)
    return ok("device", f"CUDA (training/device {device})" if gpu else cpu)


def check_interpreter(prefix: str, path_prefix: str) -> CheckResult:
    """Check that python3 on PATH belongs to the environment of the nodes. Prefixes are folders of environments."""
    if prefix == path_prefix:
        return ok("python", prefix)
    return warning(
        "python",
        f"python3 on PATH belongs to {path_prefix}, the nodes to {prefix}",
        "programs started with rosrun use python3 on PATH, which lacks the packages of the nodes",
        "deactivate other environments (conda deactivate), then source setup.bash last",
    )


def check_clock(use_sim_time: bool, clock_published: bool, robot: str) -> CheckResult:
    """Check that the clock is simulated if and only if the robot is."""
    reason = "time stamps of a simulated and of a real clock never match, so the arm does not move"
    clock = rospy.resolve_name("clock")
    if robot == SIMULATED:
        if not use_sim_time:
            return error("clock", "/use_sim_time is false", reason, "launch again; pybullet_arm.launch sets it")
        if not clock_published:
            return error("clock", f"{clock} has no publisher", reason, "start the simulated arm")
        return ok("clock", f"simulated; {clock} is published")
    if use_sim_time:
        return error(
            "clock",
            "/use_sim_time is true with a real robot, probably from an earlier simulation",
            reason,
            "rosparam set /use_sim_time false, then restart all nodes",
        )
    if clock_published:
        remedy = "end the simulation or rosbag play that publishes it"
        return warning("clock", f"{clock} has a publisher", reason, remedy)
    return ok("clock", "system time")


def check_persistent_parameters(values: Mapping[str, object]) -> List[CheckResult]:
    """Check that no parameter of an earlier launch or of an operator prevents a run. values: name -> value."""
    stale = {name: str(value) for name, value in values.items() if value}
    if not stale:
        return [ok("persistent parameters", "none: no failure, stop or pause is stored")]
    return [
        warning(
            "persistent parameters",
            f"{name} is {value!r}",
            "a run does not start or does not move while it is set",
            _parameter_remedy(name),
        )
        for name, value in stale.items()
    ]


def _parameter_remedy(name: str) -> str:
    recover = f"rosservice call {rospy.resolve_name(names.ARM_RECOVER)}"
    resume = f"rosservice call {rospy.resolve_name(names.PLANNER_RESUME)}"
    remedies = {
        "failure": "launch again; a launch clears it",
        "stopped_by": f"{recover}, once the cause is known",
        "held_for": f"check the robot, then {recover}",
        "paused_by": resume,
        "has_paused_planner": f"restart the fingerprinter, which resumes the planner, or {resume}",
    }
    return remedies.get(name.rsplit("/", 1)[-1], f"rosparam delete {name}")


def check_advertised(
    advertised: Sequence[str], required: Sequence[str], name: str, reason: str, remedy: str
) -> CheckResult:
    """Check that all required services (or topics) are advertised."""
    missing = [item for item in required if item not in advertised]
    if missing:
        return error(name, f"not advertised: {', '.join(missing)}", reason, remedy)
    return ok(name, ", ".join(required))
