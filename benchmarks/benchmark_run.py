#!/usr/bin/env python3
"""Time, processor time and memory of a learning run through roslaunch: simulation, ROS, planner, trainer, all files.

    source setup.bash && python3 benchmarks/benchmark_run.py [--steps 3000]

The paper's profile in lock-step. A short run is taken by default, from which the time of 3000 steps is extrapolated;
--steps 3000 measures it.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Dict, List, NamedTuple, Tuple

import yaml
from measuring import Row, Section, run

FULL = 3000  # steps of the paper's run
NODES = ("pybullet_arm", "ergodic_planner", "trainer", "fingerprinter", "monitor", "robot_state_publisher")
PERIOD = 0.5  # s, between two looks at the processes
TICKS = os.sysconf("SC_CLK_TCK")


class Usage(NamedTuple):
    """Processor time [s] and resident memory [MiB] of one process."""

    cpu: float
    memory: float


def learn(steps: int, root: Path) -> Tuple[float, float, Dict[str, Usage], int]:
    """Run learn.launch -> seconds in all, seconds until the first observation, what each node used, updates made."""
    arguments = [f"steps:={steps}", "session:=benchmark", f"session_root:={root}", "seed:=0"]
    environment = {**os.environ, "ROS_HOME": str(root), "ROS_HOSTNAME": "localhost"}
    port = subprocess.run(
        ["python3", str(Path(__file__).parents[1] / "tools" / "free_port.py")],
        check=True,
        capture_output=True,
        text=True,
    ).stdout.strip()
    begin, started, used = time.monotonic(), 0.0, {}
    with (root / "output.txt").open("w", encoding="utf-8") as output:
        launch = subprocess.Popen(
            ["roslaunch", "-p", port, "embodied_active_learning", "learn.launch", *arguments],
            stdout=output,
            stderr=subprocess.STDOUT,
            env=environment,
        )
        while launch.poll() is None:
            time.sleep(PERIOD)
            used.update(usage(root))
            if not started and any((root / "benchmark" / "observations").glob("*")):
                started = time.monotonic() - begin
    summary = root / "benchmark" / "summary.yaml"
    if launch.returncode or not summary.exists():
        raise SystemExit(f"the run failed:\n{(root / 'output.txt').read_text(encoding='utf-8')[-3000:]}")
    made = yaml.safe_load(summary.read_text(encoding="utf-8"))["updates"]
    return time.monotonic() - begin, started, used, made


def usage(root: Path) -> Dict[str, Usage]:
    """What the nodes of the run whose logs lie under root have used so far."""
    found: Dict[str, Usage] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            command = (folder / "cmdline").read_text(encoding="utf-8", errors="replace")
            [name] = [node for node in NODES if f"__name:={node}\0" in command and str(root) in command]
            fields = (folder / "stat").read_text(encoding="utf-8").rpartition(")")[2].split()
            pages = int((folder / "statm").read_text(encoding="utf-8").split()[1])
        except (OSError, ValueError):  # another process, or one that has just ended
            continue
        found[name] = Usage((int(fields[11]) + int(fields[12])) / TICKS, pages * os.sysconf("SC_PAGE_SIZE") / 2**20)
    return found


def measure(arguments: argparse.Namespace) -> List[Section]:
    """One section."""
    with tempfile.TemporaryDirectory() as folder:
        seconds, started, used, updates = learn(arguments.steps, Path(folder))
    rate = (seconds - started) / arguments.steps
    whole = started + FULL * rate
    measured = "" if arguments.steps == FULL else f", extrapolated from {arguments.steps} steps"
    rows = [
        Row("whole run", value=f"{whole / 60.0:.1f} min for {FULL} steps{measured}", target="10 min"),
        Row("from roslaunch to the first observation", value=f"{started:.1f} s"),
        Row("each step, its share of the updates and all files included", wall=1e3 * rate),
    ]
    for name, usage_of in sorted(used.items(), key=lambda item: -item[1].cpu):
        of_step = 1e3 * usage_of.cpu / arguments.steps
        target = "2000 MiB" if name == "trainer" else ""
        rows.append(Row(name, cpu=of_step, value=f"{usage_of.memory:.0f} MiB", target=target))
    how = (
        f"The paper's profile in lock-step, {arguments.steps} steps and {updates} updates, from roslaunch to the last"
        " picture. Processor time is of a step, the node's start included."
    )
    return [Section("A whole run", how, rows)]


if __name__ == "__main__":
    run(__doc__, measure, steps=200)
