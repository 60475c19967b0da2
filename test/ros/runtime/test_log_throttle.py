"""LogThrottle logs on change, then periodically."""

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


def test_throttle_logs_at_once_after_reset():
    throttle = LogThrottle(5.0, lambda: 100.0)
    assert throttle.should_log("no image")
    throttle.reset()
    assert throttle.should_log("no image")
