"""Starts launch files as a user does, each with its own master, and ends all processes."""

import os
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools"))

from free_port import free_port  # noqa: E402  lies in tools/, which is no package


def environment(home):
    """Return the environment of a launch with its own master and log folder."""
    return {
        **os.environ,
        "ROS_MASTER_URI": f"http://localhost:{free_port(0)}",
        "ROS_HOME": str(home),
        "ROS_HOSTNAME": "localhost",
        "ROSCONSOLE_FORMAT": "${node}: ${message}",
    }


@contextmanager
def started(command, log_path, variables):
    """Run a process with its output in a file; end it after the block."""
    with Path(log_path).open("w") as log:
        process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, env=variables, start_new_session=True)
        try:
            yield process
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
                process.wait(60)


def launched(home, *arguments, variables=None):
    """Run roslaunch with its output in home/launch.log."""
    options = ["--sigint-timeout=10", "--sigterm-timeout=3"]
    command = ["roslaunch", *options, "embodied_active_learning", *arguments]
    return started(command, Path(home) / "launch.log", variables or environment(home))


def launch_to_the_end(home, *arguments, timeout=300):
    """Run a launch file to its end and return its output."""
    with launched(home, *arguments) as process:
        process.wait(timeout)
    return (Path(home) / "launch.log").read_text()


def processes_of(launcher):
    """Return the process ids of the nodes of a roslaunch by name; the process without a name is rosmaster."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((folder / "stat").read_text().rsplit(")", 1)[1].split()[1])
            words = (folder / "cmdline").read_bytes().decode("utf-8", "replace").split("\0")
        except (OSError, IndexError, ValueError):
            continue  # the process has ended meanwhile
        if parent == launcher:
            name = next((word[len("__name:=") :] for word in words if word.startswith("__name:=")), "rosmaster")
            found[name] = int(folder.name)
    return found


def pid_of(node, launcher):
    """Return the process id of a node of a roslaunch."""
    processes = processes_of(launcher)
    assert node in processes, f"{node} is not running"
    return processes[node]
