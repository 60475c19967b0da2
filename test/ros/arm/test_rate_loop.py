"""The thread that sends set-points or velocities at a fixed rate."""

import rospy

from embodied_active_learning.ros.arm import rate_loop


def test_exception_ends_loop_and_shuts_node_down(monkeypatch):
    calls, reasons = [], []
    monkeypatch.setattr(rospy, "signal_shutdown", reasons.append)
    monkeypatch.setattr(rate_loop, "is_shutting_down", lambda: False)

    def fail():
        calls.append(None)
        raise ZeroDivisionError

    loop = rate_loop.RateLoop(1000.0, fail)
    loop._thread.join(10.0)
    assert not loop._thread.is_alive()
    assert len(calls) == 1
    assert isinstance(loop.failure, ZeroDivisionError)
    assert reasons == ["set-point thread failed: ZeroDivisionError()"]
