"""Calls with a timeout, over a socket pair instead of a server; without a master."""

import socket
from types import SimpleNamespace

import pytest
import rospy
from rospy.impl import tcpros_base
from std_srvs.srv import Trigger, TriggerRequest

from embodied_active_learning.errors import ServiceError
from embodied_active_learning.ros.runtime import timed_service
from embodied_active_learning.ros.runtime.timed_service import TimedService, interrupt_late_calls
from threads import in_a_thread, wait_for


class Proxy:
    """A client of a server that has sent its responses already, one byte each, and then hangs."""

    def __init__(self, responses):
        self._socket, self._server = socket.socketpair()
        self._server.sendall(responses)
        self.transport = SimpleNamespace(socket=self._socket)

    def __call__(self, request):
        response = self._socket.recv(1)
        if not response:
            raise rospy.ServiceException("connection lost")
        return response

    def close(self):
        self._socket.close()


@pytest.fixture(autouse=True)
def _no_timer(monkeypatch):
    """The tests interrupt late calls themselves."""
    monkeypatch.setattr(timed_service, "WallTimer", lambda period, function: None)
    monkeypatch.setattr(timed_service, "_timers", [])


@pytest.fixture
def servers(monkeypatch):
    """The responses of the servers of the next connections."""
    responses = []

    def connect(service):
        service._proxy = Proxy(responses.pop(0))

    monkeypatch.setattr(TimedService, "_connect", connect)
    return responses


def call_until_interrupted(service, timeout=0.0):
    """Call a hanging service with a timeout [s] -> the error."""
    service.timeout, errors = timeout, []

    def call():
        with pytest.raises(ServiceError) as caught:
            service.call(TriggerRequest())
        errors.append(str(caught.value))

    thread = in_a_thread(call)
    wait_for(lambda: interrupt_late_calls() or not thread.is_alive())
    service.timeout = 60.0
    return errors[0]


def test_calls_share_one_connection(servers):
    servers.append(b"ab")
    service = TimedService("name", Trigger, 60.0)
    assert [service.call(TriggerRequest()), service.call(TriggerRequest())] == [b"a", b"b"]


def test_hanging_call_is_interrupted(servers):
    servers.append(b"")
    assert call_until_interrupted(TimedService("name", Trigger, 60.0)) == "no response from /name: none within 0 s"


def test_hanging_connection_is_interrupted(monkeypatch):
    """A frozen process: the kernel accepts the connection, but no thread reads from it."""
    monkeypatch.setattr(tcpros_base, "_is_use_tcp_keepalive", lambda: False)  # it asks the master
    with socket.create_server(("127.0.0.1", 0)) as server:
        uri = f"rosrpc://127.0.0.1:{server.getsockname()[1]}"
        monkeypatch.setattr(rospy, "get_master", lambda: SimpleNamespace(lookupService=lambda name: (1, "", uri)))
        message = call_until_interrupted(TimedService("name", Trigger, 60.0), timeout=0.05)
    assert message == "no response from /name: none within 0.05 s"


def test_unknown_service_is_reported(monkeypatch):
    monkeypatch.setattr(rospy, "get_master", lambda: SimpleNamespace(lookupService=lambda name: (-1, "", "")))
    with pytest.raises(ServiceError, match="no response from /name: it is not advertised"):
        TimedService("name", Trigger, 60.0).call(TriggerRequest())


def test_call_after_interruption_connects_again(servers):
    servers.extend([b"", b"a"])
    service = TimedService("name", Trigger, 60.0)
    call_until_interrupted(service)
    assert service.call(TriggerRequest()) == b"a"


def test_call_after_response_at_the_deadline_connects_again(servers, monkeypatch):
    servers.extend([b"a", b"b"])
    receive = Proxy.__call__

    def receive_late(proxy, request):
        response = receive(proxy, request)
        interrupt_late_calls()
        return response

    monkeypatch.setattr(Proxy, "__call__", receive_late)
    service = TimedService("name", Trigger, 0.0)
    assert [service.call(TriggerRequest()), service.call(TriggerRequest())] == [b"a", b"b"]


def test_call_in_time_is_not_interrupted(servers):
    servers.append(b"ab")
    service = TimedService("name", Trigger, 60.0)
    service.call(TriggerRequest())
    interrupt_late_calls()
    assert service.call(TriggerRequest()) == b"b"
