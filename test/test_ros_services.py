"""A service that is called again and again over one connection."""

import socket
from types import SimpleNamespace

import pytest
import rospy
from std_srvs.srv import Trigger

from embodied_active_learning.ros.services import KeptService


@pytest.fixture
def connections(monkeypatch):
    """The connections that have been made: each answers with its number, or raises what `fails` says."""
    made = []

    class Connection:
        def __init__(self, _name, _class, persistent):
            assert persistent
            ours, self.theirs = socket.socketpair()
            self.transport, self.calls, self.fails = SimpleNamespace(socket=ours), 0, None
            made.append(self)

        def __call__(self):
            self.calls += 1
            if self.fails:
                raise self.fails
            return made.index(self)

        def close(self):
            self.transport.socket.close()

    monkeypatch.setattr(rospy, "ServiceProxy", Connection)
    yield made
    for connection in made:
        connection.close()
        connection.theirs.close()


def test_calls_share_a_connection(connections):
    service = KeptService("arm/move", Trigger)
    assert [service() for _ in range(3)] == [0, 0, 0]
    assert len(connections) == 1


def test_a_connection_that_the_other_side_has_closed_is_made_anew_before_the_call(connections):
    service = KeptService("arm/move", Trigger)
    service()
    connections[0].theirs.close()
    assert [service(), service()] == [1, 1]
    assert connections[0].calls == 1


def test_a_call_that_fails_on_its_way_is_not_made_again(connections):
    service = KeptService("arm/move", Trigger)
    service()
    connections[0].fails = rospy.ServiceException("transport error")
    with pytest.raises(rospy.ServiceException):
        service()
    assert [connection.calls for connection in connections] == [2]
    assert service() == 1
