"""Whether the ROS master is there, and still knows this node."""

from __future__ import annotations

import http.client
import sys
import time
from typing import Any
from xml.parsers.expat import ExpatError
from xmlrpc.client import Error as XmlRpcError
from xmlrpc.client import ServerProxy, Transport

import rosgraph
import rospy

from embodied_active_learning.ros.runtime.timers import REPEAT_AFTER, WallTimer
from embodied_active_learning.ros.runtime.wait_log import awaiting

PERIOD = 1.0
"""Wall seconds between two looks."""
TIMEOUT = 3.0
"""Wall seconds within which a master answers."""

_NO_ANSWER = (OSError, http.client.HTTPException, XmlRpcError, ExpatError)
"""What a call of a master can raise; the last one when it dies in the middle of its answer."""


def wait_for_master() -> int:
    """The ROS master's process number, once it answers; say at once, and again every few seconds, that it does not.

    To be called before init_node: rospy would wait there, too, but holding locks without which it cannot be ended.
    """
    uri = rosgraph.get_master_uri()
    master = ServerProxy(uri, transport=_PunctualTransport())
    say_at = time.monotonic()
    while True:
        try:
            return int(master.getPid("/waiting")[2])
        except _NO_ANSWER as error:
            if time.monotonic() >= say_at:
                # Not yet by the log, which a node has only when it has begun.
                sys.stderr.write(f"waiting for the ROS master at {uri}: {error}\n")
                say_at = time.monotonic() + REPEAT_AFTER
        time.sleep(0.2)


def silence_at(uri: str) -> str:
    """Why a node, or the master, at an address does not answer; empty when it does."""
    try:
        ServerProxy(uri, transport=_PunctualTransport()).getPid("/asking")
    except _NO_ANSWER as error:
        return str(error) or type(error).__name__
    return ""


class MasterWatch:
    """Ends this node when the master was restarted; says so, and waits, while the master cannot be reached.

    A master that was restarted knows neither nodes nor parameters: nobody new would find this node, and it would find
    nobody. A cable that was pulled breaks nothing that is connected.

    Its process number tells, too, because rospy makes a node known again, and no more than that, when it reads a cached
    parameter of the new master, as it does for the first message on the log. In a container both may have number 1.
    """

    def __init__(self, pid: int) -> None:
        self.lost = False
        self._pid = pid
        self._uri = rosgraph.get_master_uri()
        self._master = ServerProxy(self._uri, transport=_PunctualTransport())
        self._silence = ""
        WallTimer(PERIOD, self._look)

    def _look(self) -> None:
        if self._ask():
            return
        with awaiting(lambda: f"the ROS master at {self._uri}: {self._silence}", first_after=0.0):
            while not rospy.is_shutdown() and not self._ask():
                rospy.rostime.wallsleep(PERIOD)
        if not rospy.is_shutdown():
            rospy.loginfo("the ROS master at %s answers again", self._uri)

    def _ask(self) -> bool:
        """Whether the master has answered; the node is ended when the answer is that it does not know it."""
        name = rospy.get_name()
        try:
            _, _, pid = self._master.getPid(name)
            code, _, uri = self._master.lookupNode(name, name)
        except _NO_ANSWER as error:
            self._silence = str(error) or type(error).__name__
            return False
        known = code == 1 and uri == rospy.get_node_uri() and pid == self._pid
        if not known and not rospy.is_shutdown():
            self.lost = True
            reason = f"the ROS master at {self._uri} was restarted and does not know {name} any more"
            rospy.logfatal("%s", reason)
            rospy.signal_shutdown(reason)
        return True


class _PunctualTransport(Transport):
    """Gives up when there is no answer in time."""

    def make_connection(self, host: Any) -> http.client.HTTPConnection:
        """A connection with a time limit."""
        connection = super().make_connection(host)
        connection.timeout = TIMEOUT
        return connection
