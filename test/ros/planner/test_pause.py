"""Pausing the planner while another node commands the arm, also if that node is killed."""

import pytest
from std_srvs.srv import TriggerResponse

from embodied_active_learning.errors import EmbodiedActiveLearningError
from embodied_active_learning.ros import names
from embodied_active_learning.ros.planner import pause
from embodied_active_learning.ros.planner.pause import PlannerPause
from embodied_active_learning.ros.planner.pause_server import PauseRequests


class Planner:
    """A planner's pause and resume services, and a parameter that survives the node that pauses it."""

    def __init__(self):
        self.exists = True
        self.requests = PauseRequests()
        self.failing_calls = 0
        self.stored = None

    @property
    def is_paused(self):
        return bool(self.requests.text)

    def trigger(self, name):
        if not self.exists:
            return None
        if self.failing_calls:
            self.failing_calls -= 1
            raise EmbodiedActiveLearningError(f"{name} did not respond")
        change = self.requests.add if name == names.PLANNER_PAUSE else self.requests.release
        change("/fingerprinter")
        return TriggerResponse(True, "")


@pytest.fixture
def planner(monkeypatch):
    planner = Planner()
    monkeypatch.setattr(pause, "trigger_if_advertised", planner.trigger)
    monkeypatch.setattr(pause, "is_advertised", lambda name: planner.exists)
    monkeypatch.setattr(pause.persistent_parameters, "load", lambda name: planner.stored() if planner.stored else "")
    monkeypatch.setattr(pause.persistent_parameters, "store", lambda name, text: setattr(planner, "stored", text))
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
