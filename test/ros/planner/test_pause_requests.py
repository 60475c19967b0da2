"""Several may hold a planner back, and it goes on when nobody does any more."""

from embodied_active_learning.ros.planner.pause_requests import PauseRequests


def test_a_person_who_pauses_while_fingerprints_are_taken_finds_the_planner_paused_afterwards():
    pausers = PauseRequests()
    assert pausers.add("/fingerprinter")
    assert not pausers.add("/rosservice_1")
    assert not pausers.release("/fingerprinter")
    assert pausers.release("/rosservice_2"), "a person's next call has another name"


def test_a_person_can_end_the_pause_of_a_node_that_does_not_come_back():
    pausers = PauseRequests()
    pausers.add("/fingerprinter")
    assert pausers.release("/rosservice_1")
    assert pausers.kept == ""


def test_letting_go_what_nobody_holds_changes_nothing():
    assert not PauseRequests().release("/fingerprinter")


def test_who_holds_a_planner_back_is_kept_for_one_that_is_started_again():
    pausers = PauseRequests()
    pausers.add("/fingerprinter")
    pausers.add("/rosservice_1")
    again = PauseRequests(pausers.kept)
    assert not again.release("/fingerprinter")
    assert again.kept == "/rosservice_1"
