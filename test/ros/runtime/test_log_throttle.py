"""LogThrottle logs on change, then periodically."""

import pytest

from embodied_active_learning.ros.runtime.log_throttle import LogThrottle


def test_throttle_logs_on_change_and_after_period():
    now = [100.0]
    throttle = LogThrottle(5.0, lambda: now[0])
    assert throttle.should_log("no image")
    now[0] += 4.9
    assert not throttle.should_log("no image")
    assert throttle.should_log("no pose")
    assert throttle.should_log("no image")
    now[0] += 5.0
    assert throttle.should_log("no image")


@pytest.mark.parametrize(
    ("before", "after", "logged"),
    [
        ("the newest image is 1.00 s old", "the newest image is 2.50 s old", False),
        ("retry 1 of 5", "retry 2 of 5", False),
        ("panda_joint4 is beyond its limit", "panda_joint5 is beyond its limit", True),
    ],
)
def test_messages_that_differ_in_numbers_count_as_one(before, after, logged):
    throttle = LogThrottle(5.0, lambda: 100.0)
    throttle.should_log(before)
    assert throttle.should_log(after) == logged


def test_throttle_logs_at_once_after_reset():
    throttle = LogThrottle(5.0, lambda: 100.0)
    assert throttle.should_log("no image")
    throttle.reset()
    assert throttle.should_log("no image")
