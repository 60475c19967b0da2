"""Checks of the computers: packages, disk, device, clock, addresses, and what an earlier launch has left."""

from __future__ import annotations

from pathlib import Path
from typing import Dict, List, Mapping, NamedTuple, Sequence

from embodied_active_learning.config import SIMULATED, Config
from embodied_active_learning.errors import SessionError
from embodied_active_learning.ros.preflight.check_result import CheckResult, fine, missing, warning
from embodied_active_learning.session.disk import check_space, estimate_bytes, free_bytes


class Peer(NamedTuple):
    """A node, its address as it tells it, and why it cannot be reached from here; empty when it can."""

    name: str
    host: str
    trouble: str
    local: bool


def check_packages(needed: Mapping[str, str], absent: Sequence[str]) -> CheckResult:
    """Python packages by name, with what brings each, and those that cannot be imported here."""
    if not absent:
        return fine("packages", f"{len(needed)} of {len(needed)} can be imported")
    return missing(
        "packages",
        f"cannot be imported: {', '.join(absent)}",
        "nodes that need them do not start",
        "; ".join(dict.fromkeys(needed[name] for name in absent)) + "; then source setup.bash again",
    )


def check_disk(root: Path, config: Config) -> CheckResult:
    """Whether the folder of the sessions has room for the run."""
    try:
        check_space(root, config)
        free = free_bytes(root)
    except SessionError as error:
        return missing("disk", str(error), "every observation is stored", "as it says")
    return fine("disk", f"{free / 1e9:.0f} GB free in {root}, a run takes {estimate_bytes(config) / 1e9:.1f} GB")


def check_device(wanted: str, cuda: bool, cores: int) -> CheckResult:
    """training/device, whether torch sees a GPU, and the number of cores."""
    if wanted == "cuda" and not cuda:
        return missing(
            "learning",
            "training/device is cuda, and torch sees no CUDA device here",
            "the trainer does not start",
            "device:=auto; or see to the driver; or run preflight where the trainer is to run",
        )
    where = "a CUDA device" if cuda and wanted != "cpu" else f"{cores} cores"
    return fine("learning", f"on {where} (training/device {wanted})")


def check_clock(simulated_time: bool, clock_published: bool, robot: str) -> CheckResult:
    """/use_sim_time, and whether somebody publishes /clock, for a robot."""
    why = "stamps of a simulated and of a real clock never meet, and the arm is held still"
    if robot == SIMULATED:
        if not simulated_time:
            return missing("clock", "/use_sim_time is false", why, "pybullet_arm.launch sets it; launch again")
        if not clock_published:
            return missing("clock", "nobody publishes /clock", why, "start the simulated arm")
        return fine("clock", "simulated, and published")
    if simulated_time:
        return missing(
            "clock",
            "/use_sim_time is true, with a real robot",
            why,
            "rosparam set /use_sim_time false, and start all nodes again; it is left from a simulation",
        )
    if clock_published:
        return warning("clock", "somebody publishes /clock", why, "end the simulation or rosbag play that does")
    return fine("clock", "the computers' own")


def check_addresses(
    own: str, own_is_loopback: bool, environment: Mapping[str, str], master_is_local: bool, peers: Sequence[Peer]
) -> List[CheckResult]:
    """This computer's address as it tells it to others, ROS_IP and ROS_HOSTNAME, and all nodes that there are."""
    findings = []
    given = {name: environment[name] for name in ("ROS_HOSTNAME", "ROS_IP") if environment.get(name)}
    told = ", ".join(f"{name}={value}" for name, value in given.items()) or "neither ROS_IP nor ROS_HOSTNAME is set"
    remote = [peer for peer in peers if not peer.local]
    alone = master_is_local and not remote
    if own_is_loopback and not alone:
        findings.append(
            missing(
                "own address",
                f"{told}: others are told {own}",
                "nodes on other computers call this one there, and reach themselves",
                "unset ROS_HOSTNAME; export ROS_IP=this computer's address in that network, before anything starts",
            )
        )
    elif len(given) == 2:
        findings.append(
            warning(
                "own address", told, "ROS_HOSTNAME takes precedence, ROS_IP counts for nothing", "unset ROS_HOSTNAME"
            )
        )
    elif not given and not alone:
        findings.append(
            warning(
                "own address",
                f"{told}: others are told {own}",
                "a name that they cannot resolve makes topics come in one direction only",
                "export ROS_IP=this computer's address in that network, on every computer",
            )
        )
    else:
        findings.append(fine("own address", f"{own} ({told})"))
    silent = [f"{peer.name} at {peer.host} ({peer.trouble})" for peer in peers if peer.trouble]
    if silent:
        findings.append(
            missing(
                "other nodes",
                f"cannot be reached from here: {'; '.join(silent)}",
                "what they publish and offer does not get here",
                "set ROS_IP on their computer, and start them again; a node that is dead: rosnode cleanup",
            )
        )
    else:
        hosts = sorted({peer.host for peer in remote})
        where = f", {len(remote)} of them on {', '.join(hosts)}" if remote else ", all on this computer"
        findings.append(fine("other nodes", f"{len(peers)} can be reached{where}"))
    return findings


def check_left_over(parameters: Mapping[str, object]) -> List[CheckResult]:
    """Parameters with what they are set to that an earlier launch, or an operator, can have left behind."""
    told: Dict[str, str] = {name: str(value) for name, value in parameters.items() if value}
    if not told:
        return [fine("left-overs", "none: nobody has given up, stopped the arm or paused the planner")]
    mends = {
        "failure": "launch again: a launch begins with it empty",
        "stopped_by": "rosservice call /arm/recover, once it is clear why",
        "paused_by": "rosservice call /planner/resume",
        "has_paused_planner": "start the fingerprinter again, which resumes it; or rosservice call /planner/resume",
    }
    return [
        warning(
            "left-overs",
            f"{name} is {value!r}",
            "a run does not begin, or does not move, as long as it is set",
            mends.get(name.rsplit("/", 1)[-1], f"rosparam delete {name}, if nobody needs it"),
        )
        for name, value in told.items()
    ]


def check_services(offered: Sequence[str], needed: Sequence[str], start: str, about: str, why: str) -> CheckResult:
    """Services, or topics, by name: which of the needed ones nobody offers, and what starts them."""
    absent = [name for name in needed if name not in offered]
    if absent:
        return missing(about, f"nobody offers {', '.join(absent)}", why, start)
    return fine(about, f"{', '.join(needed)}")
