"""What stays the case is said when it is new, and again now and then."""

from embodied_active_learning.ros.runtime.log_throttle import LogThrottle


def test_a_sentence_is_due_when_it_is_new_when_it_changes_and_again_after_a_while():
    now = [100.0]
    repeats = LogThrottle(5.0, lambda: now[0])
    assert repeats.is_due("no image")
    now[0] += 4.9
    assert not repeats.is_due("no image")
    assert repeats.is_due("no pose")
    assert repeats.is_due("no image")
    now[0] += 5.0
    assert repeats.is_due("no image")


def test_a_sentence_that_was_taken_back_is_due_at_once():
    repeats = LogThrottle(5.0, lambda: 100.0)
    assert repeats.is_due("no image")
    repeats.forget()
    assert repeats.is_due("no image")
