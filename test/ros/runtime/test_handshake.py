"""Incoming TCPROS connections cannot block each other."""

import socket
import threading

import pytest
from rosgraph.network import write_ros_handshake_header
from rospy.impl import tcpros_base

from embodied_active_learning.ros.runtime import handshake


@pytest.fixture
def server(monkeypatch):
    """A TCPROS server with the timeout; it collects the sockets of complete handshakes."""
    monkeypatch.setattr(tcpros_base, "read_ros_handshake_header", tcpros_base.read_ros_handshake_header)
    monkeypatch.setattr(tcpros_base.TCPROSServer, "_tcp_server_callback", handshake._handle_connection)
    monkeypatch.setenv("ROS_HOSTNAME", "localhost")
    handshake.install_handshake_timeout()
    server = tcpros_base.TCPROSServer()
    server.accepted, server.is_complete = [], threading.Event()

    def accept(connection, address, header):
        server.accepted.append((connection.gettimeout(), header))
        server.is_complete.set()

    server.service_connection_handler = accept
    server.start_server()
    yield server
    server.shutdown()


def connect(server):
    return socket.create_connection(("localhost", server.get_address()[1]), timeout=10.0)


def test_silent_connection_does_not_block_others(server):
    with connect(server), connect(server) as client:
        write_ros_handshake_header(client, {"service": "/arm/stop"})
        assert server.is_complete.wait(10.0)


def test_connection_is_blocking_after_handshake(server):
    with connect(server) as client:
        write_ros_handshake_header(client, {"service": "/arm/stop"})
        assert server.is_complete.wait(10.0)
    assert server.accepted == [(None, {"service": "/arm/stop"})]


def test_silent_connection_is_closed_after_timeout(server, monkeypatch):
    monkeypatch.setattr(handshake, "TIMEOUT", 0.05)
    with connect(server) as client:
        assert client.recv(1) == b""
    assert server.accepted == []
