"""Requests of several nodes to pause the planner."""

from types import SimpleNamespace

import pytest
from std_srvs.srv import TriggerRequest

from embodied_active_learning.ros.planner import pause_server
from embodied_active_learning.ros.planner.pause_server import PauseRequests, PauseServer


def test_person_pause_outlasts_fingerprinter_pause():
    requests = PauseRequests()
    assert requests.add("/fingerprinter")
    assert not requests.add("/rosservice_1")
    assert not requests.release("/fingerprinter")
    assert requests.resume("/rosservice_2"), "a person's next call has another name"


def test_person_can_end_pause_of_dead_node():
    requests = PauseRequests()
    requests.add("/fingerprinter")
    assert requests.resume("/rosservice_1")
    assert requests.text == ""


def test_node_released_by_person_ends_no_later_pause():
    requests = PauseRequests()
    requests.add("/fingerprinter")
    requests.resume("/rosservice_1")
    requests.add("/rosservice_2")
    assert not requests.release("/fingerprinter")
    assert requests.text == "/rosservice_2"


def test_node_released_by_person_can_pause_again():
    requests = PauseRequests()
    requests.add("/fingerprinter")
    requests.resume("/rosservice_1")
    requests.add("/fingerprinter")
    assert requests.release("/fingerprinter")


def test_person_can_end_a_pause_after_another_one():
    """rqt has the same name in all calls."""
    requests = PauseRequests()
    requests.add("/rqt")
    requests.resume("/rosservice_1")
    requests.add("/fingerprinter")
    assert requests.resume("/rqt")


def test_release_without_pause_changes_nothing():
    assert not PauseRequests().release("/fingerprinter")
    assert not PauseRequests().resume("/rosservice_1")


@pytest.mark.parametrize(
    ("paused_by", "success", "message"),
    [("", True, "was not paused"), ("/rosservice_1 /fingerprinter", False, "still paused by /rosservice_1")],
)
def test_resume_succeeds_unless_others_pause(monkeypatch, paused_by, success, message):
    monkeypatch.setattr(pause_server.persistent_parameters, "load", lambda name: paused_by)
    monkeypatch.setattr(pause_server.persistent_parameters, "store", lambda name, text: None)
    monkeypatch.setattr(pause_server, "name_of_caller", lambda request: "/fingerprinter")
    response = PauseServer(SimpleNamespace(pause=lambda cause: None)).resume(TriggerRequest())
    assert (response.success, response.message) == (success, message)


def test_status_names_who_paused(monkeypatch):
    monkeypatch.setattr(pause_server.persistent_parameters, "load", lambda name: "/operator /fingerprinter")
    monkeypatch.setattr(pause_server.persistent_parameters, "store", lambda name, text: None)
    monkeypatch.setattr(pause_server, "name_of_caller", lambda request: "/operator")
    shown = []
    server = PauseServer(SimpleNamespace(pause=shown.append))
    server.release(TriggerRequest())
    assert [text.partition("pause by ")[2] for text in shown] == ["/fingerprinter /operator", "/fingerprinter"]


def test_pause_reports_whether_planner_was_paused_before(monkeypatch):
    monkeypatch.setattr(pause_server.persistent_parameters, "load", lambda name: "")
    monkeypatch.setattr(pause_server.persistent_parameters, "store", lambda name, text: None)
    monkeypatch.setattr(pause_server, "name_of_caller", lambda request: "/operator")
    server = PauseServer(SimpleNamespace(pause=lambda cause: None, stop=lambda: None))
    assert [server.pause(TriggerRequest()).message for _ in range(2)] == ["paused", "already paused"]


def test_pause_requests_restored_from_text():
    requests = PauseRequests()
    requests.add("/fingerprinter")
    requests.add("/rosservice_1")
    again = PauseRequests(requests.text)
    assert not again.release("/fingerprinter")
    assert again.text == "/rosservice_1"
