"""A node in its own process, which tests kill, freeze and end."""

import os
import signal
import subprocess
from pathlib import Path
from xmlrpc.client import ServerProxy

import rosgraph
import rospy

from launching import frozen


class NodeProcess:
    """Runs with the master of the test, in its process group."""

    def __init__(self, node):
        self.log = Path(os.environ["ROS_HOME"]) / f"{node}.log"
        environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
        with self.log.open("ab") as log:
            command = ["rosrun", "embodied_active_learning", node]
            self.process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, env=environment)

    @property
    def last_line(self):
        return self.log.read_text().rstrip().rpartition("\n")[2]

    def kill(self):
        self.process.kill()
        self.process.wait()

    def freeze(self):
        self.process.send_signal(signal.SIGSTOP)

    def thaw(self):
        self.process.send_signal(signal.SIGCONT)

    def end(self, timeout=20.0):
        """End the node, even if it is frozen, and return its exit status."""
        self.process.send_signal(signal.SIGINT)
        self.thaw()
        try:
            return self.process.wait(timeout)
        finally:
            self.process.kill()


def frozen_node(name):
    """Freeze any running node while the block runs."""
    caller = rospy.get_name()
    _, _, process = ServerProxy(rosgraph.Master(caller).lookupNode(name)).getPid(caller)
    return frozen(process)
