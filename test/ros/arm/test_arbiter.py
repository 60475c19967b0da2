"""Arbitration of the arm: one commander at a time, stops, recoveries and expiry."""

import threading
from contextlib import nullcontext
from types import SimpleNamespace

import pytest

from embodied_active_learning.errors import ArmBusyError, ArmStoppedError
from embodied_active_learning.ros.arm.arbiter import ArmArbiter
from threads import in_a_thread, wait_for


class Clock:
    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


def request(caller):
    return SimpleNamespace(_connection_header={"callerid": caller})


def test_second_node_is_rejected_with_commander_name():
    arbiter = ArmArbiter(5.0, Clock())
    with arbiter.command(request("/ergodic_planner")):
        pass
    with pytest.raises(ArmBusyError, match="/ergodic_planner controls the arm"), arbiter.command(
        request("/fingerprinter")
    ):
        pass


def test_arm_is_free_after_commander_timeout():
    clock = Clock()
    arbiter = ArmArbiter(5.0, clock)
    with arbiter.command(request("/ergodic_planner")):
        pass
    clock.now = 5.1
    assert arbiter.commander == ""
    with arbiter.command(request("/fingerprinter")):
        assert arbiter.commander == "/fingerprinter"


def test_long_command_keeps_control():
    clock = Clock()
    arbiter = ArmArbiter(5.0, clock)
    with arbiter.command(request("/ergodic_planner")):
        clock.now = 100.0
        with pytest.raises(ArmBusyError, match="executing a command"), arbiter.command(request("/fingerprinter")):
            pass


def test_stop_by_other_node_lasts_until_recovery():
    arbiter = ArmArbiter(5.0, Clock())
    with arbiter.command(request("/ergodic_planner")):
        pass
    with arbiter.stop(request("/operator")):
        pass
    with pytest.raises(ArmStoppedError, match="stopped by /operator"), arbiter.command(request("/ergodic_planner")):
        pass
    with arbiter.recovery():
        pass
    with arbiter.command(request("/ergodic_planner")):
        pass


def test_stop_by_commander_releases_control_after_stopping():
    arbiter = ArmArbiter(5.0, Clock())
    with arbiter.command(request("/ergodic_planner")):
        pass
    with arbiter.stop(request("/ergodic_planner")):
        assert arbiter.commander == "/ergodic_planner", "another node would move the arm before it has stopped"
    assert arbiter.commander == ""
    with arbiter.command(request("/fingerprinter")):
        assert arbiter.commander == "/fingerprinter"


def test_commander_may_command_after_its_own_stop():
    arbiter = ArmArbiter(5.0, Clock())
    for _ in range(2):
        with arbiter.command(request("/ergodic_planner")):
            pass
        with arbiter.stop(request("/ergodic_planner")):
            pass
    with arbiter.command(request("/ergodic_planner")):
        assert arbiter.commander == "/ergodic_planner"
    assert arbiter.commander == "/ergodic_planner"


def test_stop_during_command_releases_control_after_command():
    arbiter = ArmArbiter(5.0, Clock())
    stopped = []

    def stop():
        with arbiter.stop(request("/ergodic_planner")):
            stopped.append(True)

    with arbiter.command(request("/ergodic_planner")) as signal:
        thread = in_a_thread(stop)
        wait_for(signal.is_set)
        with pytest.raises(ArmBusyError, match="executing a command"), arbiter.command(request("/fingerprinter")):
            pass
        assert not stopped
    thread.join(10.0)
    assert stopped
    assert arbiter.commander == ""


def test_command_that_waits_for_own_stop_keeps_control():
    arbiter = ArmArbiter(5.0, Clock())
    started, finish = threading.Event(), threading.Event()

    def command():
        with arbiter.command(request("/ergodic_planner")):
            started.set()
            finish.wait(10.0)

    with arbiter.command(request("/ergodic_planner")):
        pass
    with arbiter.stop(request("/ergodic_planner")):
        thread = in_a_thread(command)
        wait_for(lambda: arbiter._busy)
        assert not started.is_set()
    assert started.wait(10.0)
    finish.set()
    thread.join(10.0)
    arbiter.heartbeat(request("/ergodic_planner"))
    assert arbiter.commander == "/ergodic_planner"


def test_waiting_command_is_rejected_after_stop():
    clock = Clock()
    arbiter = commanded(clock)
    clock.now = 5.1
    moved, rejected = [], []

    def command():
        try:
            with arbiter.command(request("/ergodic_planner")):
                moved.append(True)
        except ArmStoppedError as error:
            rejected.append(error)

    def stop():
        with arbiter.stop(request("/operator")):
            pass

    with arbiter.hold_for_silent_commander():  # the arm brakes
        threads = [in_a_thread(command)]
        wait_for(lambda: arbiter.commander == "/ergodic_planner")
        threads.append(in_a_thread(stop))
        wait_for(lambda: arbiter.stopped_by == "/operator")
    for thread in threads:
        thread.join(10.0)
    assert (len(moved), len(rejected)) == (0, 1)


def test_stop_during_recovery_stays_in_force():
    arbiter = ArmArbiter(5.0, Clock(), stopped_by="/planner")
    with pytest.raises(ArmStoppedError, match="stopped by /operator"), arbiter.recovery(), arbiter.stop(
        request("/operator")
    ):
        pass
    assert arbiter.stopped_by == "/operator"


def test_failed_recovery_leaves_arm_stopped():
    arbiter = ArmArbiter(5.0, Clock(), stopped_by="/operator")
    with pytest.raises(ZeroDivisionError), arbiter.recovery():
        raise ZeroDivisionError
    assert arbiter.stopped_by == "/operator"


def test_stop_survives_restart_of_arm_node():
    arbiter = ArmArbiter(5.0, Clock(), stopped_by="/operator")
    with pytest.raises(ArmStoppedError, match="/operator"), arbiter.command(request("/ergodic_planner")):
        pass
    with arbiter.recovery():
        pass
    with arbiter.command(request("/ergodic_planner")):
        pass


def test_no_command_after_close():
    """It waits for the lock of the motion, which is not released any more."""
    arbiter = commanded(Clock())
    arbiter.close()
    assert not arbiter._motion_lock.acquire(blocking=False)


class OpenLock(nullcontext):
    """A lock that any thread acquires at once."""

    def acquire(self):
        return True


def test_command_after_close_is_signalled_to_stop():
    arbiter = commanded(Clock())
    arbiter._motion_lock = OpenLock()
    arbiter.close()
    with arbiter.command(request("/ergodic_planner")) as signal:
        assert signal.is_set()


def test_stop_by_previous_commander_needs_recovery():
    arbiter = ArmArbiter(5.0, Clock())
    with arbiter.command(request("/ergodic_planner")):
        pass
    with arbiter.stop(request("/ergodic_planner")):
        pass
    with arbiter.command(request("/fingerprinter")):
        pass
    with arbiter.stop(request("/ergodic_planner")):
        pass
    with pytest.raises(ArmStoppedError, match="stopped by /ergodic_planner"), arbiter.command(
        request("/fingerprinter")
    ):
        pass


def test_stop_of_free_arm_needs_recovery():
    arbiter = ArmArbiter(5.0, Clock())
    with arbiter.stop(request("/operator")) as needs_recovery:
        assert needs_recovery
    with pytest.raises(ArmStoppedError, match="/operator"), arbiter.command(request("/ergodic_planner")):
        pass


@pytest.mark.parametrize("released", [False, True])
def test_stop_by_former_commander_needs_recovery(released):
    """It is a person's, since nodes of the package stop the arm only while they control it."""
    clock = Clock()
    arbiter = commanded(clock)
    if released:
        with arbiter.stop(request("/ergodic_planner")):
            pass
    else:
        clock.now = 5.1
    with arbiter.stop(request("/ergodic_planner")) as needs_recovery:
        assert needs_recovery
    assert arbiter.stopped_by == "/ergodic_planner"


def test_heartbeat_extends_control():
    clock = Clock()
    arbiter = commanded(clock)
    for clock.now in (4.0, 8.0, 12.0):
        arbiter.heartbeat(request("/ergodic_planner"))
    assert arbiter.commander == "/ergodic_planner"
    clock.now = 17.1
    assert arbiter.commander == ""


def test_heartbeat_of_other_or_expired_node_is_rejected():
    clock = Clock()
    arbiter = commanded(clock)
    with pytest.raises(ArmBusyError, match="/ergodic_planner controls the arm, not /fingerprinter"):
        arbiter.heartbeat(request("/fingerprinter"))
    clock.now = 5.1
    with pytest.raises(ArmBusyError, match="no node controls the arm, not /ergodic_planner"):
        arbiter.heartbeat(request("/ergodic_planner"))


def test_heartbeat_of_stopped_arm_is_rejected():
    arbiter = commanded(Clock())
    with arbiter.stop(request("/operator")):
        pass
    assert (arbiter.commander, arbiter.stopped_by) == ("", "/operator")
    with pytest.raises(ArmStoppedError, match="call /arm/recover"):
        arbiter.heartbeat(request("/ergodic_planner"))
    with arbiter.recovery():
        pass
    assert arbiter.stopped_by == ""


def expired(arbiter):
    with arbiter.hold_for_silent_commander() as commander:
        return commander


def test_expired_commander_is_reported_once():
    clock = Clock()
    arbiter = commanded(clock)
    assert expired(arbiter) == ""
    clock.now = 5.1
    assert expired(arbiter) == "/ergodic_planner"
    assert expired(arbiter) == ""


def test_released_arm_does_not_expire():
    clock = Clock()
    arbiter = commanded(clock)
    with arbiter.stop(request("/ergodic_planner")):
        pass
    clock.now = 5.1
    assert expired(arbiter) == ""


def test_idle_time_counts_from_last_command():
    clock = Clock()
    assert ArmArbiter(5.0, clock).idle_time is None
    arbiter = commanded(clock)
    clock.now = 2.5
    arbiter.heartbeat(request("/ergodic_planner"))
    assert arbiter.idle_time == 2.5


def commanded(clock):
    """An arbiter that has granted a command of the planner."""
    arbiter = ArmArbiter(5.0, clock)
    with arbiter.command(request("/ergodic_planner")):
        pass
    return arbiter


def test_failed_command_leaves_arm_free():
    arbiter = ArmArbiter(5.0, Clock())
    with pytest.raises(ZeroDivisionError), arbiter.command(request("/a")):
        raise ZeroDivisionError
    with arbiter.command(request("/a")):
        pass


@pytest.mark.parametrize("caller", ["/operator", "/ergodic_planner"])
def test_stop_signal_names_stopping_node(caller):
    arbiter = ArmArbiter(5.0, Clock())
    events = []

    def stop():
        with arbiter.stop(request(caller)):
            events.append("stopped")

    with arbiter.command(request("/ergodic_planner")) as signal:
        assert not signal.is_set()
        thread = in_a_thread(stop)
        wait_for(signal.is_set)
        assert not events, "the stop must wait until the command has ended"
    thread.join(10.0)
    assert (signal.by, events) == (caller, ["stopped"])


def test_stop_signal_is_not_set_for_later_command():
    arbiter = commanded(Clock())
    with arbiter.stop(request("/ergodic_planner")):
        pass
    with arbiter.command(request("/ergodic_planner")) as signal:
        assert not signal.is_set()


def test_close_ends_command_in_progress():
    arbiter = ArmArbiter(5.0, Clock())
    with arbiter.command(request("/ergodic_planner")) as signal:
        thread = in_a_thread(arbiter.close)
        wait_for(signal.is_set)
    thread.join(10.0)
    assert not thread.is_alive()
