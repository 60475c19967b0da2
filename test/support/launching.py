"""Starting launch files as a user does, each with a master of its own, and never leaving anything behind."""

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
    """The environment of a launch that has master and log folder to itself."""
    return {
        **os.environ,
        "ROS_MASTER_URI": f"http://localhost:{free_port(0)}",
        "ROS_HOME": str(home),
        "ROS_HOSTNAME": "localhost",
        "ROSCONSOLE_FORMAT": "${node}: ${message}",
    }


@contextmanager
def started(command, log_path, variables):
    """A process of ours, its output in a file. Ended when the block ends."""
    with Path(log_path).open("w") as log:
        process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, env=variables, start_new_session=True)
        try:
            yield process
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
                process.wait(60)


def launched(home, *arguments, variables=None):
    """roslaunch with arguments, its output in home/launch.log."""
    options = ["--sigint-timeout=10", "--sigterm-timeout=3"]
    command = ["roslaunch", *options, "embodied_active_learning", *arguments]
    return started(command, Path(home) / "launch.log", variables or environment(home))


def launch_to_the_end(home, *arguments, timeout=300):
    """Run a launch file until it ends by itself -> what it printed."""
    with launched(home, *arguments) as process:
        process.wait(timeout)
    return (Path(home) / "launch.log").read_text()


def processes_of(launcher):
    """Process numbers of what a roslaunch has started, by the names of the nodes; what has no name is the rosmaster."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((folder / "stat").read_text().rsplit(")", 1)[1].split()[1])
            words = (folder / "cmdline").read_bytes().decode("utf-8", "replace").split("\0")
        except (OSError, IndexError, ValueError):
            continue  # it has ended meanwhile
        if parent == launcher:
            name = next((word[len("__name:=") :] for word in words if word.startswith("__name:=")), "rosmaster")
            found[name] = int(folder.name)
    return found


def pid_of(node, launcher):
    """The process of a node that this launcher started."""
    processes = processes_of(launcher)
    assert node in processes, f"{node} is not running"
    return processes[node]
