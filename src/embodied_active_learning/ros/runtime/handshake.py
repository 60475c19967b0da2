"""Timeout of rospy's handshake on incoming connections.

rospy reads the header of a new connection without a timeout, in the thread that accepts connections. A connection that
sends nothing, for example from a port scanner, would block all services of the node, including arm/stop.
"""

from __future__ import annotations

import socket
import threading
from typing import Any, BinaryIO, Dict

from rospy.impl import tcpros_base

TIMEOUT = 5.0
"""Seconds without data after which an incomplete handshake is closed."""

_read_header = tcpros_base.read_ros_handshake_header
_handle_connection = tcpros_base.TCPROSServer._tcp_server_callback


def install_handshake_timeout() -> None:
    """Patch rospy so that each handshake runs in its own thread and with a timeout."""
    tcpros_base.read_ros_handshake_header = _read_header_and_unset_timeout
    tcpros_base.TCPROSServer._tcp_server_callback = _handle_connection_in_thread


def _handle_connection_in_thread(server: Any, connection: socket.socket, address: Any) -> None:
    connection.settimeout(TIMEOUT)
    threading.Thread(target=_handle_connection, args=(server, connection, address), daemon=True).start()


def _read_header_and_unset_timeout(connection: socket.socket, buffer: BinaryIO, size: int) -> Dict[str, str]:
    """Read a header, also of an outgoing connection, and make the connection blocking as rospy expects."""
    header = _read_header(connection, buffer, size)
    connection.settimeout(None)
    return header
