"""Calls of services whose server or master is gone."""

import http.client
from types import SimpleNamespace
from xml.parsers.expat import ExpatError

import pytest
import rospy
from std_srvs.srv import Trigger, TriggerRequest

from embodied_active_learning.errors import ObservationError, ServiceError
from embodied_active_learning.ros.runtime import services, wait_log


@pytest.mark.parametrize("error", [ConnectionRefusedError(), http.client.IncompleteRead(b""), ExpatError()])
def test_lookup_waits_for_master(monkeypatch, error):
    errors = [error]

    def look_up(name):
        if errors:
            raise errors.pop()
        return 1, "", "rosrpc://localhost:1"

    monkeypatch.setattr(rospy, "get_master", lambda: SimpleNamespace(lookupService=look_up))
    monkeypatch.setattr(services, "_MASTER_PERIOD", 0.0)
    assert services.is_advertised("arm/stop")


def retrying_service(monkeypatch, *outcomes):
    """A client whose calls end one after the other with an error or a response."""
    left = list(outcomes)

    def call(_request):
        outcome = left.pop(0)
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    call.close = lambda: None
    monkeypatch.setattr(rospy, "resolve_name", lambda name: f"/{name}")
    monkeypatch.setattr(rospy, "is_shutdown", lambda: False)
    monkeypatch.setattr(rospy, "wait_for_service", lambda name, timeout: None)
    monkeypatch.setattr(rospy, "ServiceProxy", lambda name, service_class, persistent: call)
    return services.RetryingService("observe", None)


def test_call_is_repeated_until_there_is_a_response(monkeypatch):
    assert retrying_service(monkeypatch, ConnectionRefusedError(), rospy.ServiceException("gone"), 1).call(None) == 1


def test_wait_names_the_last_error(monkeypatch):
    waits = []
    monkeypatch.setattr(services.time, "sleep", lambda _seconds: waits.append(wait_log.longest_wait().what))
    retrying_service(monkeypatch, rospy.ServiceException("no route to host"), 1).call(None)
    assert waits == ["a response of /observe (no route to host)"]


def test_server_with_another_definition_is_an_error(monkeypatch):
    mismatch = rospy.ServiceException("unable to connect: md5sums do not match: [a] vs. [b]")
    with pytest.raises(ServiceError, match=r"/observe has another definition: .*one version of the package"):
        retrying_service(monkeypatch, mismatch).call(None)


def test_error_of_the_handler_is_not_repeated(monkeypatch):
    with pytest.raises(ServiceError, match=r"/observe failed: .*see its node's log"):
        retrying_service(monkeypatch, rospy.ServiceException("service responded with an error: b''")).call(None)


def test_error_of_advertised_service_becomes_unsuccessful_response(monkeypatch):
    def refuse(_request):
        raise ObservationError("image has 0 bytes")

    advertised = {}
    monkeypatch.setattr(rospy, "Service", lambda name, service_class, handler: advertised.update({name: handler}))
    services.advertise_service("observe", Trigger, refuse)
    response = advertised["observe"](TriggerRequest())
    assert (response.success, response.message) == (False, "image has 0 bytes")
