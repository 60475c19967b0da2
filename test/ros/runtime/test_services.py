"""Calls of services while the ROS master is gone."""

import http.client
from types import SimpleNamespace
from xml.parsers.expat import ExpatError

import pytest
import rospy

from embodied_active_learning.ros.runtime import services


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


@pytest.mark.parametrize("error", [http.client.IncompleteRead(b""), ExpatError()])
def test_dying_master_is_an_error_of_transport(error):
    assert isinstance(error, services.TRANSPORT_ERRORS)
