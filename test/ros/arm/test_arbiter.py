"""One commander of the arm at a time."""

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


def test_a_second_node_is_refused_with_the_name_of_the_first():
    commander = ArmArbiter(5.0, Clock())
    with commander.command(request("/ergodic_planner")):
        pass
    with pytest.raises(ArmBusyError, match="driven by /ergodic_planner"), commander.command(request("/fingerprinter")):
        pass


def test_the_arm_is_free_again_when_its_commander_has_been_silent():
    clock = Clock()
    commander = ArmArbiter(5.0, clock)
    with commander.command(request("/ergodic_planner")):
        pass
    clock.now = 5.1
    assert commander.holder == ""
    with commander.command(request("/fingerprinter")):
        assert commander.holder == "/fingerprinter"


def test_the_time_of_a_long_command_does_not_free_the_arm():
    clock = Clock()
    commander = ArmArbiter(5.0, clock)
    with commander.command(request("/ergodic_planner")):
        clock.now = 100.0
        with pytest.raises(ArmBusyError, match="carrying out"), commander.command(request("/fingerprinter")):
            pass


def test_a_stop_by_another_node_lasts_until_somebody_recovers_the_arm():
    commander = ArmArbiter(5.0, Clock())
    with commander.command(request("/ergodic_planner")):
        pass
    with commander.stop(request("/operator")):
        pass
    with pytest.raises(ArmStoppedError, match="stopped by /operator"), commander.command(request("/ergodic_planner")):
        pass
    commander.recover()
    with commander.command(request("/ergodic_planner")):
        pass


def test_a_driver_that_stops_its_own_arm_gives_it_back_at_once():
    commander = ArmArbiter(5.0, Clock())
    with commander.command(request("/ergodic_planner")):
        pass
    with commander.stop(request("/ergodic_planner")):
        assert commander.holder == "/ergodic_planner", "another node would move the arm before it has stopped"
    assert commander.holder == ""
    with commander.command(request("/fingerprinter")):
        assert commander.holder == "/fingerprinter"


def test_a_driver_that_stops_its_own_arm_may_go_on():
    commander = ArmArbiter(5.0, Clock())
    for _ in range(2):
        with commander.command(request("/ergodic_planner")):
            pass
        with commander.stop(request("/ergodic_planner")):
            pass
    with commander.command(request("/ergodic_planner")):
        assert commander.holder == "/ergodic_planner"
    assert commander.holder == "/ergodic_planner"


def test_a_driver_that_stops_its_arm_amid_a_command_gives_it_back_after_the_command():
    commander = ArmArbiter(5.0, Clock())
    stopped = []

    def stop():
        with commander.stop(request("/ergodic_planner")):
            stopped.append(True)

    with commander.command(request("/ergodic_planner")):
        thread = in_a_thread(stop)
        with pytest.raises(ArmBusyError, match="carrying out"), commander.command(request("/fingerprinter")):
            pass
        assert not stopped
    thread.join(10.0)
    assert stopped
    assert commander.holder == ""


def test_a_command_that_waits_for_the_arm_is_not_carried_out_after_a_stop():
    clock = Clock()
    commander = driven(clock)
    clock.now = 5.1
    moved, refused = [], []

    def command():
        try:
            with commander.command(request("/ergodic_planner")):
                moved.append(True)
        except ArmStoppedError as error:
            refused.append(error)

    def stop():
        with commander.stop(request("/operator")):
            pass

    with commander.lapsed():  # the arm brakes
        threads = [in_a_thread(command)]
        wait_for(lambda: commander.holder == "/ergodic_planner")
        threads.append(in_a_thread(stop))
        wait_for(lambda: commander.stopped_by == "/operator")
    for thread in threads:
        thread.join(10.0)
    assert (len(moved), len(refused)) == (0, 1)


def test_a_stop_that_comes_while_somebody_recovers_the_arm_lasts():
    commander = ArmArbiter(5.0, Clock(), stopped_by="/planner")
    with pytest.raises(ArmStoppedError, match="stopped by /operator"), commander.recovery(), commander.stop(
        request("/operator")
    ):
        pass
    assert commander.stopped_by == "/operator"


def test_a_recovery_that_fails_leaves_the_arm_stopped():
    commander = ArmArbiter(5.0, Clock(), stopped_by="/operator")
    with pytest.raises(ZeroDivisionError), commander.recovery():
        raise ZeroDivisionError
    assert commander.stopped_by == "/operator"


def test_a_stop_lasts_longer_than_the_node_in_front_of_the_arm():
    commander = ArmArbiter(5.0, Clock(), stopped_by="/operator")
    with pytest.raises(ArmStoppedError, match="/operator"), commander.command(request("/ergodic_planner")):
        pass
    commander.recover()
    with commander.command(request("/ergodic_planner")):
        pass


def test_nobody_moves_an_arm_that_has_ended():
    commander = driven(Clock())
    commander.end()
    moved = []

    def command():
        with commander.command(request("/ergodic_planner")):
            moved.append(True)

    in_a_thread(command).join(0.1)
    assert not moved


class WonByAll(nullcontext):
    """A lock that whoever asks for it has first."""

    def acquire(self):
        return True


def test_a_command_that_has_its_turn_before_the_end_that_it_came_after_is_told_of_it():
    commander = driven(Clock())
    commander._turn = WonByAll()
    commander.end()
    with commander.command(request("/ergodic_planner")) as interruption:
        assert interruption.happened()


def test_a_stop_by_the_last_driver_stops_the_next_one_like_anybody_elses():
    commander = ArmArbiter(5.0, Clock())
    with commander.command(request("/ergodic_planner")):
        pass
    with commander.stop(request("/ergodic_planner")):
        pass
    with commander.command(request("/fingerprinter")):
        pass
    with commander.stop(request("/ergodic_planner")):
        pass
    with pytest.raises(ArmStoppedError, match="stopped by /ergodic_planner"), commander.command(
        request("/fingerprinter")
    ):
        pass


def test_a_stop_of_an_arm_that_nobody_drives_lasts_as_well():
    commander = ArmArbiter(5.0, Clock())
    with commander.stop(request("/operator")) as lasts:
        assert lasts
    with pytest.raises(ArmStoppedError, match="/operator"), commander.command(request("/ergodic_planner")):
        pass


def test_a_driver_that_stops_its_arm_when_its_time_has_lapsed_holds_nobody_up():
    clock = Clock()
    commander = driven(clock)
    clock.now = 5.1
    with commander.stop(request("/ergodic_planner")) as lasts:
        assert not lasts
    with commander.command(request("/fingerprinter")):
        pass


def test_a_driver_that_says_it_is_alive_keeps_the_arm_between_commands():
    clock = Clock()
    commander = driven(clock)
    for clock.now in (4.0, 8.0, 12.0):
        commander.keep(request("/ergodic_planner"))
    assert commander.holder == "/ergodic_planner"
    clock.now = 17.1
    assert commander.holder == ""


def test_only_the_driver_keeps_the_arm_and_only_while_it_has_it():
    clock = Clock()
    commander = driven(clock)
    with pytest.raises(ArmBusyError, match="driven by /ergodic_planner, not by /fingerprinter"):
        commander.keep(request("/fingerprinter"))
    clock.now = 5.1
    with pytest.raises(ArmBusyError, match="driven by nobody, not by /ergodic_planner"):
        commander.keep(request("/ergodic_planner"))


def test_a_stopped_arm_is_kept_by_nobody_and_takes_no_command_until_it_is_recovered():
    commander = driven(Clock())
    with commander.stop(request("/operator")):
        pass
    assert (commander.holder, commander.stopped_by) == ("", "/operator")
    with pytest.raises(ArmStoppedError, match="call /arm/recover"):
        commander.keep(request("/ergodic_planner"))
    commander.recover()
    assert commander.stopped_by == ""


def lapsed(commander):
    with commander.lapsed() as driver:
        return driver


def test_a_driver_that_falls_silent_is_told_of_once():
    clock = Clock()
    commander = driven(clock)
    assert lapsed(commander) == ""
    clock.now = 5.1
    assert lapsed(commander) == "/ergodic_planner"
    assert lapsed(commander) == ""


def test_a_driver_that_has_given_the_arm_back_does_not_fall_silent():
    clock = Clock()
    commander = driven(clock)
    with commander.stop(request("/ergodic_planner")):
        pass
    clock.now = 5.1
    assert lapsed(commander) == ""


def test_the_last_command_was_so_long_ago():
    clock = Clock()
    assert ArmArbiter(5.0, clock).silence is None
    commander = driven(clock)
    clock.now = 2.5
    commander.keep(request("/ergodic_planner"))
    assert commander.silence == 2.5


def driven(clock):
    """A commander that has taken a command of the planner."""
    commander = ArmArbiter(5.0, clock)
    with commander.command(request("/ergodic_planner")):
        pass
    return commander


def test_a_command_that_fails_does_not_leave_the_arm_busy():
    commander = ArmArbiter(5.0, Clock())
    with pytest.raises(ZeroDivisionError), commander.command(request("/a")):
        raise ZeroDivisionError
    with commander.command(request("/a")):
        pass


@pytest.mark.parametrize("caller", ["/operator", "/ergodic_planner"])
def test_a_command_that_takes_time_is_told_of_a_stop_and_by_whom(caller):
    commander = ArmArbiter(5.0, Clock())
    told = []

    def stop():
        with commander.stop(request(caller)):
            told.append("stopped")

    with commander.command(request("/ergodic_planner")) as interruption:
        assert not interruption.happened()
        thread = in_a_thread(stop)
        wait_for(interruption.happened)
        assert not told, "it waits until the command has ended"
    thread.join(10.0)
    assert (interruption.by, told) == (caller, ["stopped"])


def test_a_stop_tells_only_the_command_that_is_under_way():
    commander = driven(Clock())
    with commander.stop(request("/ergodic_planner")):
        pass
    with commander.command(request("/ergodic_planner")) as interruption:
        assert not interruption.happened()


def test_an_arm_that_ends_does_not_wait_for_a_command_that_looks():
    commander = ArmArbiter(5.0, Clock())
    with commander.command(request("/ergodic_planner")) as interruption:
        thread = in_a_thread(commander.end)
        wait_for(interruption.happened)
    thread.join(10.0)
    assert not thread.is_alive()
