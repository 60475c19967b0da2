#!/usr/bin/env python3
"""Time, processor time and memory of a learning run with roslaunch: simulation, planner, trainer and all files.

    source setup.bash && python3 benchmarks/benchmark_run.py [--steps 3000]

Default settings in lock-step. By default the time of 3000 steps is extrapolated from a short run; --steps 3000
measures it.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Dict, List, NamedTuple, Tuple

import yaml
from measuring import Row, Section, run

FULL = 3000  # steps of the paper's run
NODES = ("pybullet_arm", "ergodic_planner", "trainer", "fingerprinter", "monitor", "robot_state_publisher")
LEARNING = 80  # steps after which every step has its updates
PERIOD = 0.5  # s, between two measurements
STEP_TIMEOUT = 2.0  # s per step, plus START_TIMEOUT for the whole run
START_TIMEOUT = 120.0  # s
TICKS = os.sysconf("SC_CLK_TCK")


class Usage(NamedTuple):
    """Processor time [s] and resident memory [MiB] of one process."""

    cpu: float
    memory: float


class Learned(NamedTuple):
    """A run: (seconds since roslaunch, steps made) over time, the largest usage of each node, updates made."""

    progress: List[Tuple[float, int]]
    used: Dict[str, Usage]
    updates: int


def learn(steps: int, root: Path) -> Learned:
    """Run learn.launch. Raises SystemExit with the end of its output if it fails or times out."""
    arguments = [f"steps:={steps}", "session:=benchmark", f"session_root:={root}", "seed:=0"]
    environment = {**os.environ, "ROS_HOME": str(root), "ROS_HOSTNAME": "localhost"}
    find_port = ["python3", str(Path(__file__).parents[1] / "tools" / "free_port.py"), "11311"]
    port = subprocess.run(find_port, check=True, capture_output=True, text=True).stdout.strip()
    begin, deadline = time.monotonic(), time.monotonic() + STEP_TIMEOUT * steps + START_TIMEOUT
    progress: List[Tuple[float, int]] = []
    used: Dict[str, Usage] = {}
    with (root / "output.txt").open("w", encoding="utf-8") as output:
        command = ["roslaunch", "-p", port, "embodied_active_learning", "learn.launch", *arguments]
        launch = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, env=environment)
        try:
            while launch.poll() is None and time.monotonic() < deadline:
                time.sleep(PERIOD)
                progress.append((time.monotonic() - begin, steps_made(root)))
                for name, now in usage(root).items():
                    used[name] = Usage(now.cpu, max(now.memory, used[name].memory if name in used else 0.0))
        finally:
            if launch.poll() is None:
                launch.send_signal(signal.SIGINT)
                launch.wait()
    summary = root / "benchmark" / "summary.yaml"
    if launch.returncode or not summary.exists():
        raise SystemExit(f"the run failed:\n{(root / 'output.txt').read_text(encoding='utf-8')[-3000:]}")
    return Learned(progress, used, yaml.safe_load(summary.read_text(encoding="utf-8"))["updates"])


def steps_made(root: Path) -> int:
    """Return the number of rows in the session's table of steps."""
    table = root / "benchmark" / "exploration.csv"
    return max(0, table.read_bytes().count(b"\n") - 1) if table.exists() else 0


def usage(root: Path) -> Dict[str, Usage]:
    """Return the usage so far of the nodes whose logs are under root, by name."""
    found: Dict[str, Usage] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            command = (folder / "cmdline").read_text(encoding="utf-8", errors="replace")
            [name] = [node for node in NODES if f"__name:={node}\0" in command and str(root) in command]
            fields = (folder / "stat").read_text(encoding="utf-8").rpartition(")")[2].split()
            pages = int((folder / "statm").read_text(encoding="utf-8").split()[1])
        except (OSError, ValueError):  # not a node of this run, or ended meanwhile
            continue
        found[name] = Usage((int(fields[11]) + int(fields[12])) / TICKS, pages * os.sysconf("SC_PAGE_SIZE") / 2**20)
    return found


def measure(arguments: argparse.Namespace) -> List[Section]:
    """Return one section."""
    with tempfile.TemporaryDirectory() as folder:
        learned = learn(arguments.steps, Path(folder))
    begun = next(moment for moment in learned.progress if moment[1] >= LEARNING)
    # The last step waits for the remaining updates, whose number does not depend on the length of the run.
    explored = next(moment for moment in learned.progress if moment[1] >= arguments.steps - 1)
    started = next(time for time, steps in learned.progress if steps)
    rate = (explored[0] - begun[0]) / (explored[1] - begun[1])
    ending = learned.progress[-1][0] - explored[0]
    whole = begun[0] + (FULL - begun[1]) * rate + ending
    measured = "" if arguments.steps == FULL else f", extrapolated from {arguments.steps} steps"
    rows = [
        Row("whole run", value=f"{whole / 60.0:.1f} min for {FULL} steps{measured}", target="10 min"),
        Row("roslaunch to first step", value=f"{started:.1f} s"),
        Row("one step with its three updates, including files", wall=1e3 * rate),
        Row("last step to the end: last updates, model, figures", value=f"{ending:.1f} s"),
    ]
    for name, used in sorted(learned.used.items(), key=lambda item: -item[1].cpu):
        target = "2000 MiB" if name == "trainer" else ""
        rows.append(Row(name, cpu=1e3 * used.cpu / arguments.steps, value=f"{used.memory:.0f} MiB", target=target))
    how = (
        f"Default settings in lock-step, {arguments.steps} steps and {learned.updates} updates, from roslaunch to"
        " the last picture. Processor time of a node: all of it divided by the steps, its start included."
    )
    return [Section("A whole run", how, rows)]


if __name__ == "__main__":
    run(__doc__, measure, steps=200)
