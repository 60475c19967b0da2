"""Pausing the planner while another node commands the arm, also if that node is killed."""

import pytest
from std_srvs.srv import TriggerResponse

from embodied_active_learning.errors import EmbodiedActiveLearningError
from embodied_active_learning.ros import names
from embodied_active_learning.ros.planner import pause
from embodied_active_learning.ros.planner.pause import PlannerPause, planner_paused_by
from embodied_active_learning.ros.planner.pause_server import PauseRequests


class Planner:
    """A planner's pause and resume services, and a parameter that survives the node that pauses it."""

    def __init__(self):
        self.exists = True
        self.requests = PauseRequests()
        self.failing_calls = 0
        self.calls_until_restart = 0
        self.stored = None
        self.waits = []

    @property
    def is_paused(self):
        return bool(self.requests.text)

    def trigger(self, name):
        if not self.exists:
            return None
        if self.calls_until_restart:
            self.calls_until_restart -= 1
            return None
        if self.failing_calls:
            self.failing_calls -= 1
            self.requests = PauseRequests(self.requests.text)  # it has restarted
            raise EmbodiedActiveLearningError(f"{name} did not respond")
        changes = {names.PLANNER_PAUSE: self.requests.add, names.PLANNER_RELEASE_PAUSE: self.requests.release}
        changes[name]("/fingerprinter")
        return TriggerResponse(True, "")

    def load(self, name):
        if name == names.PLANNER_PAUSED_BY:
            return self.requests.text
        return self.stored() if self.stored else ""


@pytest.fixture
def planner(monkeypatch):
    planner = Planner()
    monkeypatch.setattr(pause, "trigger_if_advertised", planner.trigger)
    monkeypatch.setattr(pause, "is_advertised", lambda name: planner.exists)
    monkeypatch.setattr(pause.persistent_parameters, "load", planner.load)
    monkeypatch.setattr(pause.persistent_parameters, "store", lambda name, text: setattr(planner, "stored", text))
    monkeypatch.setattr(pause, "wall_sleep", planner.waits.append)
    monkeypatch.setattr(pause.rospy, "get_name", lambda: "/fingerprinter")
    return planner


def test_planner_paused_during_block_only(planner):
    def fail():
        with PlannerPause().paused():
            assert planner.is_paused
            raise KeyError

    with pytest.raises(KeyError):
        fail()
    assert not planner.is_paused
    assert planner.stored() == ""


def test_unreachable_master_names_no_pause(planner, monkeypatch):
    def refuse(name):
        raise ConnectionRefusedError(name)

    monkeypatch.setattr(pause.persistent_parameters, "load", refuse)
    assert planner_paused_by() == ""


def test_planner_paused_before_stays_paused(planner):
    planner.requests.add("/rosservice_1")
    with PlannerPause().paused():
        pass
    assert planner.is_paused


def test_pause_without_planner_does_nothing(planner):
    planner.exists = False
    with PlannerPause().paused():
        assert planner.stored() == ""


def test_resume_retried_if_planner_does_not_respond(planner):
    with PlannerPause().paused():
        planner.failing_calls = 2
    assert not planner.is_paused
    assert len(planner.waits) == 2, "one before each retry"


def test_resume_waits_for_restarting_planner(planner):
    with PlannerPause().paused():
        planner.calls_until_restart = 2
    assert not planner.is_paused


def test_resume_does_not_wait_for_ended_planner(planner):
    with PlannerPause().paused():
        planner.exists, planner.requests = False, PauseRequests()
    assert planner.waits == []
    assert planner.stored() == ""


def test_pause_without_response_is_ended(planner):
    """As if the planner had crashed before its response, but after it stored the request."""
    planner.requests.add("/fingerprinter")
    planner.requests.add("/rosservice_1")
    planner.failing_calls = 3
    with pytest.raises(EmbodiedActiveLearningError, match="did not respond"), PlannerPause().paused():
        pytest.fail("the planner is not paused")
    assert planner.requests.text == "/rosservice_1"
    assert planner.stored() == ""


def test_lost_pause_keeps_pauses_of_others(planner):
    planner.requests.add("/rosservice_1")
    planner.failing_calls = 1
    with pytest.raises(EmbodiedActiveLearningError), PlannerPause().paused():
        pytest.fail("the planner is not paused")
    assert planner.requests.text == "/rosservice_1"


def test_unended_pause_is_left_to_the_next_process(planner):
    planner.requests.add("/fingerprinter")
    planner.failing_calls = 10**4
    with pytest.raises(EmbodiedActiveLearningError), PlannerPause().paused():
        pytest.fail("the planner is not paused")
    assert planner.stored() != ""
    planner.failing_calls = 0
    PlannerPause().resume_if_left()
    assert not planner.is_paused


def test_restarted_node_ends_pause_of_its_predecessor(planner):
    killed = PlannerPause().paused()
    killed.__enter__()
    PlannerPause().resume_if_left()
    assert not planner.is_paused
    assert planner.stored() == ""


def test_restarted_node_keeps_pause_of_others(planner):
    with PlannerPause().paused():
        pass
    planner.requests.add("/rosservice_1")
    PlannerPause().resume_if_left()
    assert planner.is_paused
