"""Check that no node of a running system leaks memory, file descriptors or threads.

    source setup.bash
    roslaunch embodied_active_learning learn.launch steps:=3000 &
    python3 experiments/soak.py

Samples all nodes until learning has finished, or for --seconds; prints a table, and exits 1 if something grows. Growth
is that of a straight line fitted to the second half of the samples. The first half is for warm-up: it should include
the trainer's first seven or eight checkpoints (training/checkpoint_every), whose memory is reused by later ones. The
images that the trainer keeps in memory are subtracted.
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

RESOURCES = ("memory", "descriptors", "threads")
UNITS = {"memory": "MB", "descriptors": "", "threads": ""}
LIMITS = {"memory": 8.0, "descriptors": 2.0, "threads": 2.0}
"""Growth in the second half that is tolerated: usage fluctuates, and memory is freed in larger pieces than taken."""
RELATIVE_LIMIT = 0.02
"""Tolerated growth of memory relative to its size; the larger limit counts."""


@dataclass(frozen=True)
class Sample:
    """Resources of a process at one time."""

    time: float  # [s]
    memory: float  # [MB] private, without files
    descriptors: int
    threads: int


def sample(process: int) -> Optional[Sample]:
    """Sample a process; None if it has ended."""
    folder = Path(f"/proc/{process}")
    try:
        status = dict(line.split(":", 1) for line in (folder / "status").read_text().splitlines())
        descriptors = len(os.listdir(folder / "fd"))
        return Sample(time.monotonic(), int(status["RssAnon"].split()[0]) / 1024, descriptors, int(status["Threads"]))
    except (OSError, KeyError):  # the status of an ending process lacks its memory
        return None


def growth(samples: Sequence[Sample], resource: str) -> float:
    """Return how much a straight line fitted to the second half of the samples grows."""
    half = samples[len(samples) // 2 :]
    times = np.array([item.time for item in half])
    rate = np.polyfit(times, [getattr(item, resource) for item in half], 1)[0]
    return float(rate * (times[-1] - times[0]))


def growing(samples: Sequence[Sample], memory: float = LIMITS["memory"]) -> List[str]:
    """Return the resources that grow beyond their limit; memory: limit in MB."""
    limits = {**LIMITS, "memory": max(memory, RELATIVE_LIMIT * samples[-1].memory)}
    return [resource for resource in RESOURCES if growth(samples, resource) > limits[resource]]


def table(tracks: Dict[str, Sequence[Sample]]) -> str:
    """Return a Markdown table: each node's resources at the end, and their growth in the second half."""
    lines = ["| node | " + " | ".join(f"{resource} at the end | growth" for resource in RESOURCES) + " | |"]
    lines.append("| --- |" + " --- |" * (2 * len(RESOURCES) + 1))
    for node, samples in tracks.items():
        cells = []
        for resource in RESOURCES:
            value = f"{getattr(samples[-1], resource):.0f} {UNITS[resource]}".strip()
            cells += [value, f"{growth(samples, resource):+.1f}"]
        lines.append(f"| {node} | {' | '.join(cells)} | {', '.join(growing(samples)) or 'nothing'} grows |")
    return "\n".join(lines)


def write_csv(path: Path, tracks: Dict[str, Sequence[Sample]]) -> None:
    """Write all samples as rows."""
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["node", *(item.name for item in fields(Sample))])
        writer.writerows([node, *astuple(item)] for node, samples in tracks.items() for item in samples)


class Sampler:
    """Samples the nodes of a namespace periodically."""

    def __init__(self, config: Config) -> None:
        self._image = config.camera.height * config.camera.width * 3 / 2**20  # [MB]
        self._observations = 0
        self._ended = threading.Event()
        self._processes: Dict[str, int] = {}
        self.tracks: Dict[str, List[Sample]] = {}
        rospy.Subscriber(names.TRAINING_STATUS, TrainingStatus, self._on_status, queue_size=1)

    def run(self, period: float, seconds: float) -> None:
        """Sample every period [s] until the time is over, learning has finished, or a node has ended."""
        deadline = time.monotonic() + seconds
        rospy.on_shutdown(self._ended.set)
        while time.monotonic() < deadline:
            self._find_nodes()
            samples = {node: sample(process) for node, process in self._processes.items()}
            if None in samples.values():
                return
            for node, item in samples.items():
                images = self._image * self._observations if node.endswith("/trainer") else 0.0
                self.tracks[node].append(Sample(item.time, item.memory - images, item.descriptors, item.threads))
            if self._ended.wait(period):
                return

    def _find_nodes(self) -> None:
        for node in nodes_of(rospy.get_namespace()):
            if node not in self._processes:
                self._processes[node], self.tracks[node] = pid_of(node), []

    def _on_status(self, message: TrainingStatus) -> None:
        self._observations = message.observations
        if message.finished:  # what follows, such as figures, happens once
            self._ended.set()


def nodes_of(namespace: str) -> List[str]:
    """Return the registered nodes of a namespace, without this one."""
    state = rosgraph.Master(rospy.get_name()).getSystemState()
    nodes = {node for kind in state for _, owners in kind for node in owners}
    return sorted(node for node in nodes if node.startswith(namespace) and node not in (rospy.get_name(), "/rosout"))


def pid_of(node: str) -> int:
    """Return the process of a node on this machine."""
    uri = rosgraph.Master(rospy.get_name()).lookupNode(node)
    return xmlrpc.client.ServerProxy(uri).getPid(rospy.get_name())[2]


def main() -> None:
    """Sample the nodes and print the result."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--period", type=float, default=2.0, help="seconds between two samples")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="duration; default: until the run ends")
    parser.add_argument("--csv", type=Path, help="file for all samples")
    options = parser.parse_args(rospy.myargv()[1:])
    rospy.init_node("soak", anonymous=True)
    parameter = rospy.resolve_name(names.CONFIG_PARAMETER)
    wait_until(lambda: rospy.has_param(parameter), lambda: f"a launch that sets {parameter}")
    sampler = Sampler(read_config())
    sampler.run(options.period, options.seconds)
    if options.csv:
        write_csv(options.csv, sampler.tracks)
    print(table(sampler.tracks))
    print(f"{max(map(len, sampler.tracks.values()))} samples, every {options.period:g} s")
    sys.exit(any(growing(track) for track in sampler.tracks.values()))


if __name__ == "__main__":
    main()
