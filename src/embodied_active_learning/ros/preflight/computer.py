"""Checks of this computer: Python, packages, disk, device, clock, parameters of an earlier launch."""

from __future__ import annotations

from pathlib import Path
from typing import List, Mapping, Sequence

from embodied_active_learning.config import SIMULATED, Config
from embodied_active_learning.errors import SessionError
from embodied_active_learning.ros.preflight.check_result import CheckResult, error, ok, warning
from embodied_active_learning.session.disk import check_space, estimate_bytes, free_bytes

_REMEDIES = {
    "failure": "launch again; a launch clears it",
    "stopped_by": "rosservice call /arm/recover, once the cause is known",
    "paused_by": "rosservice call /planner/resume",
    "has_paused_planner": "restart the fingerprinter, which resumes the planner, or rosservice call /planner/resume",
}


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


def check_device(device: str, cuda: bool, cores: int) -> CheckResult:
    """Check that the device of training/device exists."""
    if device == "cuda" and not cuda:
        return error(
            "device",
            "training/device is cuda, but torch finds no CUDA device",
            "the trainer does not start",
            "set device:=auto, fix the GPU driver, or run preflight on the computer of the trainer",
        )
    used = "CUDA" if cuda and device != "cpu" else f"CPU with {cores} cores"
    return ok("device", f"{used} (training/device {device})")


def check_clock(use_sim_time: bool, clock_published: bool, robot: str) -> CheckResult:
    """Check that the clock is simulated if and only if the robot is."""
    reason = "time stamps of a simulated and of a real clock never match, so the arm does not move"
    if robot == SIMULATED:
        if not use_sim_time:
            return error("clock", "/use_sim_time is false", reason, "launch again; pybullet_arm.launch sets it")
        if not clock_published:
            return error("clock", "/clock has no publisher", reason, "start the simulated arm")
        return ok("clock", "simulated; /clock is published")
    if use_sim_time:
        return error(
            "clock",
            "/use_sim_time is true with a real robot, probably from an earlier simulation",
            reason,
            "rosparam set /use_sim_time false, then restart all nodes",
        )
    if clock_published:
        return warning("clock", "/clock has a publisher", reason, "end the simulation or rosbag play that publishes it")
    return ok("clock", "system time")


def check_stale_parameters(values: Mapping[str, object]) -> List[CheckResult]:
    """Check that no parameter of an earlier launch or of an operator prevents a run. values: name -> value."""
    stale = {name: str(value) for name, value in values.items() if value}
    if not stale:
        return [ok("stale parameters", "none: no failure, stop or pause is stored")]
    return [
        warning(
            "stale parameters",
            f"{name} is {value!r}",
            "a run does not start or does not move while it is set",
            _REMEDIES.get(name.rsplit("/", 1)[-1], f"rosparam delete {name}"),
        )
        for name, value in stale.items()
    ]


def check_advertised(
    advertised: Sequence[str], required: Sequence[str], name: str, reason: str, remedy: str
) -> CheckResult:
    """Check that all required services (or topics) are advertised."""
    missing = [item for item in required if item not in advertised]
    if missing:
        return error(name, f"not advertised: {', '.join(missing)}", reason, remedy)
    return ok(name, ", ".join(required))
