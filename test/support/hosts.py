"""Several computers and their network: namespaces of this one, connected by a bridge."""

import os
import shutil
import subprocess
from contextlib import contextmanager

ROBOT, SERVER = "robot", "server"
ADDRESSES = {ROBOT: "10.77.0.1", SERVER: "10.77.0.2"}


class Hosts:
    """Runs processes as if on several computers. Several tests may do so at the same time."""

    def __init__(self, addresses=None):
        self.addresses = addresses or ADDRESSES
        self._switch = f"eal-switch-{os.getpid()}"

    def namespace(self, host):
        return f"eal-{host}-{os.getpid()}"

    def command(self, host, *words):
        """Return the command line that runs a command on a host."""
        return ["ip", "netns", "exec", self.namespace(host), *map(str, words)]

    def environment(self, host, home):
        """The variables of docs/two_computers.md, for one host."""
        variables = {key: value for key, value in os.environ.items() if key != "ROS_HOSTNAME"}
        return {
            **variables,
            "ROS_MASTER_URI": f"http://{ADDRESSES[ROBOT]}:11311",
            "ROS_IP": self.addresses[host],
            "ROS_HOME": str(home),
            "ROSCONSOLE_FORMAT": "${node}: ${message}",
        }

    def pull_cable(self):
        """Disconnect the server from the switch."""
        self._ip("-n", self._switch, "link", "set", SERVER, "down")

    def plug_cable(self):
        self._ip("-n", self._switch, "link", "set", SERVER, "up")

    def make(self):
        self._ip("netns", "add", self._switch)
        self._ip("-n", self._switch, "link", "add", "bridge", "type", "bridge")
        self._ip("-n", self._switch, "link", "set", "bridge", "up")
        for host, address in self.addresses.items():
            namespace = self.namespace(host)
            self._ip("netns", "add", namespace)
            self._ip("-n", self._switch, "link", "add", host, "type", "veth", "peer", "eth0", "netns", namespace)
            self._ip("-n", self._switch, "link", "set", host, "master", "bridge", "up")
            self._ip("-n", namespace, "address", "add", f"{address}/24", "dev", "eth0")
            self._ip("-n", namespace, "link", "set", "eth0", "up")
            self._ip("-n", namespace, "link", "set", "lo", "up")

    def limit(self, megabits):
        """Limit each link to a rate [Mb/s] in both directions, with buckets of 8 ms."""
        bucket = ["rate", f"{megabits}mbit", "burst", str(megabits * 1000), "latency", "50ms"]
        for host in self.addresses:
            for namespace, device in ((self._switch, host), (self.namespace(host), "eth0")):
                command = ["tc", "-n", namespace, "qdisc", "replace", "dev", device, "root", "tbf", *bucket]
                subprocess.run(command, check=True, capture_output=True)

    def remove(self):
        for name in (self._switch, *map(self.namespace, self.addresses)):
            subprocess.run(["ip", "netns", "delete", name], check=False, capture_output=True)

    def _ip(self, *words):
        subprocess.run(["ip", *words], check=True, capture_output=True)


def why_not():
    """Return why namespaces cannot be created here; empty if they can."""
    if shutil.which("ip") is None:
        return "ip (iproute2) is not installed"
    hosts = Hosts()
    try:
        hosts.make()
    except subprocess.CalledProcessError as error:
        return f"network namespaces cannot be created: {error.stderr.decode().strip()}"
    finally:
        hosts.remove()
    return ""


@contextmanager
def connected_hosts(addresses=None):
    """Yield connected hosts, by default robot and server. addresses: IPv4 address by name."""
    hosts = Hosts(addresses)
    try:
        hosts.make()
        yield hosts
    finally:
        hosts.remove()
