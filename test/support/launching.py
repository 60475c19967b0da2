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
from threads import wait_while_running  # noqa: E402


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


@contextmanager
def frozen(process):
    """Freeze a process, given by its id, while the block runs."""
    os.kill(process, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(process, signal.SIGCONT)


def rows(table):
    """Return the number of rows of a CSV file; 0 if it does not exist yet."""
    return len(table.read_text().splitlines()) - 1 if table.exists() else 0


def is_finished(session):
    """Return whether a session has all files of a complete learning run."""
    check = [sys.executable, ROOT / "tools" / "check_session.py", "learned", session]
    return subprocess.run(check, check=False, capture_output=True).returncode == 0


class Run:
    """A launch in progress, whose output is in home/launch.log, and the session that it writes below home."""

    def __init__(self, home, session, process, variables):
        self.home, self.path = home, home / session
        self.process, self.variables = process, variables

    @property
    def log(self):
        return (self.home / "launch.log").read_text()

    @property
    def steps(self):
        """The number of steps in the planner's table."""
        return rows(self.path / "exploration.csv")

    def pid(self, node):
        return pid_of(node, self.process.pid)

    def wait_for(self, condition, timeout=120):
        """Return once a condition holds; fail if the launch ends before."""
        wait_while_running(self.process, condition, timeout, lambda: self.log)
