"""Holding back a planner while another node drives the arm, also when that node is killed meanwhile."""

import pytest
from std_srvs.srv import TriggerResponse

from embodied_active_learning.errors import EmbodiedActiveLearningError
from embodied_active_learning.ros import names
from embodied_active_learning.ros.planner import pause
from embodied_active_learning.ros.planner.pause import PlannerPause


class Planner:
    """Answers as a planner does, unless it is not there; what was kept outlives whoever paused it."""

    def __init__(self):
        self.is_there = True
        self.is_paused = False
        self.silent_for = 0  # calls
        self.kept = None

    def trigger(self, name):
        if not self.is_there:
            return None
        if self.silent_for:
            self.silent_for -= 1
            raise EmbodiedActiveLearningError(f"{name} did not answer")
        before, self.is_paused = self.is_paused, name == names.PLANNER_PAUSE
        return TriggerResponse(before != self.is_paused, "")


@pytest.fixture
def planner(monkeypatch):
    planner = Planner()
    monkeypatch.setattr(pause, "trigger_if_advertised", planner.trigger)
    monkeypatch.setattr(pause, "is_advertised", lambda name: planner.is_there)
    monkeypatch.setattr(pause.persistent_parameters, "load", lambda name: planner.kept() if planner.kept else "")
    monkeypatch.setattr(pause.persistent_parameters, "store", lambda name, text: setattr(planner, "kept", text))
    return planner


def test_a_planner_is_paused_for_the_time_of_a_block_and_no_longer_whatever_happens_in_it(planner):
    def fail():
        with PlannerPause().held():
            assert planner.is_paused
            raise KeyError

    with pytest.raises(KeyError):
        fail()
    assert not planner.is_paused
    assert planner.kept() == ""


def test_a_planner_that_somebody_else_has_paused_stays_so(planner):
    planner.is_paused = True
    with PlannerPause().held():
        pass
    assert planner.is_paused


def test_where_there_is_no_planner_there_is_nothing_to_pause(planner):
    planner.is_there = False
    with PlannerPause().held():
        assert planner.kept() == ""


def test_a_planner_that_answers_late_goes_on(planner):
    with PlannerPause().held():
        planner.silent_for = 2
    assert not planner.is_paused


def test_a_planner_whose_pause_was_never_ended_goes_on_when_the_node_is_started_again(planner):
    killed = PlannerPause().held()
    killed.__enter__()
    PlannerPause().resume_if_left()
    assert not planner.is_paused
    assert planner.kept() == ""


def test_a_node_that_is_started_again_leaves_other_pauses_alone(planner):
    with PlannerPause().held():
        pass
    planner.is_paused = True
    PlannerPause().resume_if_left()
    assert planner.is_paused
