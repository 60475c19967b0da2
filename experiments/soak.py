"""Follows the nodes of a running system: memory, file handles and threads of each must not grow while it learns.

    source setup.bash
    roslaunch embodied_active_learning learn.launch steps:=3000 &
    python3 experiments/soak.py

Follows them until everything is learned, or for --seconds; prints a table, and exits 1 when something has grown. What
counts is the straight line through the second half. The first is for warming up: it should be long enough for the
trainer's first seven or eight checkpoints (training/checkpoint_every), which take memory that is kept and used again by
the later ones. The trainer keeps all images in memory, which is what it is for: they are subtracted.
"""

from __future__ import annotations

import argparse
import csv
import os
import sys
import threading
import time
import xmlrpc.client
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import Dict, List, Optional, Sequence

import numpy as np
import rosgraph
import rospy
from embodied_active_learning.msg import TrainingStatus

from embodied_active_learning.config import Config
from embodied_active_learning.ros import names
from embodied_active_learning.ros.runtime.node import read_config, wait_until

KINDS = ("memory", "handles", "threads")
UNITS = {"memory": "MB", "handles": "", "threads": ""}
LIMITS = {"memory": 8.0, "handles": 2.0, "threads": 2.0}
"""How much more there may be at the end of the second half than at its beginning: what comes and goes is not the same
at every look, and memory is freed in larger pieces than it is taken."""
SHARE = 0.02
"""How much more memory there may be, as a share of what the node has; the larger of the two counts."""


@dataclass(frozen=True)
class Look:
    """What a process has at one moment."""

    time: float  # [s]
    memory: float  # [MB] of its own, without what is shared or a copy of a file
    handles: int
    threads: int


def look(process: int) -> Optional[Look]:
    """Look at a process; None when it is gone."""
    folder = Path(f"/proc/{process}")
    try:
        status = dict(line.split(":", 1) for line in (folder / "status").read_text().splitlines())
        handles = len(os.listdir(folder / "fd"))
        return Look(time.monotonic(), int(status["RssAnon"].split()[0]) / 1024, handles, int(status["Threads"]))
    except (OSError, KeyError):  # a process that ends has a status without memory
        return None


def growth(looks: Sequence[Look], kind: str) -> float:
    """By how much a straight line through the second half of the looks rises from its beginning to its end."""
    half = looks[len(looks) // 2 :]
    times = np.array([item.time for item in half])
    slope = np.polyfit(times, [getattr(item, kind) for item in half], 1)[0]
    return float(slope * (times[-1] - times[0]))


def what_grows(looks: Sequence[Look], memory: float = LIMITS["memory"]) -> List[str]:
    """The kinds that grow by more than their limit; that of memory can be set [MB]."""
    limits = {**LIMITS, "memory": max(memory, SHARE * looks[-1].memory)}
    return [kind for kind in KINDS if growth(looks, kind) > limits[kind]]


def table(tracks: Dict[str, Sequence[Look]]) -> str:
    """For each node what it has at the end, and by how much that has grown in the second half."""
    lines = ["| node | " + " | ".join(f"{kind} at the end | growth" for kind in KINDS) + " | |"]
    lines.append("| --- |" + " --- |" * (2 * len(KINDS) + 1))
    for node, looks in tracks.items():
        cells = []
        for kind in KINDS:
            cells += [f"{getattr(looks[-1], kind):.0f} {UNITS[kind]}".strip(), f"{growth(looks, kind):+.1f}"]
        lines.append(f"| {node} | {' | '.join(cells)} | {', '.join(what_grows(looks)) or 'nothing'} grows |")
    return "\n".join(lines)


def write_csv(path: Path, tracks: Dict[str, Sequence[Look]]) -> None:
    """Every look as a row."""
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["node", *(item.name for item in fields(Look))])
        writer.writerows([node, *astuple(item)] for node, looks in tracks.items() for item in looks)


class Follower:
    """Looks at the nodes of a namespace again and again."""

    def __init__(self, config: Config) -> None:
        self._image = config.camera.height * config.camera.width * 3 / 2**20  # [MB]
        self._observations = 0
        self._ended = threading.Event()
        self._processes: Dict[str, int] = {}
        self.tracks: Dict[str, List[Look]] = {}
        rospy.Subscriber(names.TRAINING_STATUS, TrainingStatus, self._on_status, queue_size=1)

    def follow(self, period: float, seconds: float) -> None:
        """Look every period [s], until the time is over, all is learned or a node is gone."""
        ends_at = time.monotonic() + seconds
        rospy.on_shutdown(self._ended.set)
        while time.monotonic() < ends_at:
            self._find_nodes()
            looks = {node: look(process) for node, process in self._processes.items()}
            if None in looks.values():
                return
            for node, item in looks.items():
                images = self._image * self._observations if node.endswith("/trainer") else 0.0
                self.tracks[node].append(Look(item.time, item.memory - images, item.handles, item.threads))
            if self._ended.wait(period):
                return

    def _find_nodes(self) -> None:
        for node in nodes_of(rospy.get_namespace()):
            if node not in self._processes:
                self._processes[node], self.tracks[node] = pid_of(node), []

    def _on_status(self, message: TrainingStatus) -> None:
        self._observations = message.observations
        if message.finished:  # what follows, figures say, is done once
            self._ended.set()


def nodes_of(namespace: str) -> List[str]:
    """The nodes that the master knows in a namespace, without this one."""
    state = rosgraph.Master(rospy.get_name()).getSystemState()
    nodes = {node for kind in state for _, owners in kind for node in owners}
    return sorted(node for node in nodes if node.startswith(namespace) and node not in (rospy.get_name(), "/rosout"))


def pid_of(node: str) -> int:
    """The process of a node on this machine."""
    uri = rosgraph.Master(rospy.get_name()).lookupNode(node)
    return xmlrpc.client.ServerProxy(uri).getPid(rospy.get_name())[2]


def main() -> None:
    """Follow the nodes and print what came out."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--period", type=float, default=2.0, help="seconds between two looks")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="how long; default: until all is learned")
    parser.add_argument("--csv", type=Path, help="file for every single look")
    options = parser.parse_args(rospy.myargv()[1:])
    rospy.init_node("soak", anonymous=True)
    parameter = rospy.resolve_name(names.CONFIG_PARAMETER)
    wait_until(lambda: rospy.has_param(parameter), lambda: f"a launch that sets {parameter}")
    follower = Follower(read_config())
    follower.follow(options.period, options.seconds)
    if options.csv:
        write_csv(options.csv, follower.tracks)
    print(table(follower.tracks))
    print(f"{max(map(len, follower.tracks.values()))} looks, every {options.period:g} s")
    sys.exit(any(what_grows(track) for track in follower.tracks.values()))


if __name__ == "__main__":
    main()
