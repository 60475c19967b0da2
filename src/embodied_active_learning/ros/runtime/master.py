"""Reachability of the ROS master and of other nodes."""

from __future__ import annotations

import http.client
import sys
import time
from typing import Any
from xml.parsers.expat import ExpatError
from xmlrpc.client import Error as XmlRpcError
from xmlrpc.client import ServerProxy, Transport

import rosgraph

from embodied_active_learning.ros.runtime.log_throttle import LogThrottle

_TIMEOUT = 3.0
"""Wall seconds within which a master or node responds."""


CALL_ERRORS = (OSError, http.client.HTTPException, XmlRpcError, ExpatError)
"""Exceptions of a call of the ROS master or of a node that is gone. ExpatError: it died while it responded."""


def server_proxy(uri: str) -> Any:
    """Return an XML-RPC proxy of a master or node whose calls have a timeout."""
    return ServerProxy(uri, transport=_TimeoutTransport())


def master_proxy() -> Any:
    """Return an XML-RPC proxy of the ROS master whose calls have a timeout, unlike rospy's. They raise CALL_ERRORS."""
    return server_proxy(rosgraph.get_master_uri())


def connection_error(uri: str) -> str:
    """Return why the XML-RPC server of a master or node does not respond; empty if it does."""
    try:
        server_proxy(uri).getPid("/ping")
    except CALL_ERRORS as error:
        return str(error) or type(error).__name__
    return ""


def wait_for_master() -> None:
    """Return once the ROS master responds.

    To be called before init_node, which waits for the master too, but while it holds locks that block its shutdown.
    """
    uri, throttle = rosgraph.get_master_uri(), LogThrottle()
    while True:
        error = connection_error(uri)
        if not error:
            return
        message = f"waiting for the ROS master at {uri}: {error}; start it, or correct ROS_MASTER_URI\n"
        if throttle.should_log(message):
            sys.stderr.write(message)  # the node has no log yet
        time.sleep(0.2)


class _TimeoutTransport(Transport):
    """XML-RPC transport with a timeout."""

    def make_connection(self, host: Any) -> http.client.HTTPConnection:
        connection = super().make_connection(host)
        connection.timeout = _TIMEOUT
        return connection
