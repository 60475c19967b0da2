"""What nodes tell on /diagnostics: rates on wall time, overruns, and what they are waiting for."""

import threading

import pytest

from embodied_active_learning.errors import BusyError
from embodied_active_learning.ros.runtime.diagnostics import ERROR, OK, WARN, Health, Pace, Rate, with_wait
from embodied_active_learning.ros.runtime.exclusive_task import ExclusiveTask
from embodied_active_learning.ros.runtime.wait_log import Wait, awaiting, longest_wait


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now

    def advance(self, seconds):
        self.now += seconds


@pytest.fixture
def clock():
    return Clock()


def test_a_rate_is_that_of_the_last_seconds(clock):
    rate = Rate(window=10.0, clock=clock)
    assert rate.per_second == 0.0
    assert rate.age is None
    for _ in range(20):
        clock.advance(0.5)
        rate.tick(3)
    assert rate.per_second == pytest.approx(6.0)
    assert (rate.count, rate.age) == (60, 0.0)
    clock.advance(5.0)
    assert 0.0 < rate.per_second < 6.0
    clock.advance(6.0)
    assert rate.per_second == 0.0
    assert (rate.count, rate.age) == (60, 11.0)


def test_a_pace_counts_the_steps_that_took_too_long_but_not_the_pauses(clock):
    pace = Pace(0.2, clock)
    for seconds in (0.1, 0.1, 0.5, 0.1, 0.3):
        clock.advance(seconds)
        pace.step()
    values = pace.values()
    assert (values["overruns"], values["last overrun [s]"]) == (2, 0.3)
    pace.interrupt()
    clock.advance(100.0)
    pace.step()
    assert pace.values()["overruns"] == 2


def test_what_is_awaited_is_the_wait_that_lasts_longest():
    assert longest_wait() is None
    with awaiting(lambda: "the arm"), awaiting(lambda: "an answer"):
        assert longest_wait().what == "the arm"
    assert longest_wait() is None


def test_a_wait_is_over_also_when_it_fails():
    with pytest.raises(KeyError), awaiting(lambda: "the arm"):
        raise KeyError
    assert longest_wait() is None


@pytest.mark.parametrize(
    ("health", "seconds", "level", "message"),
    [
        (Health(OK, "exploring"), 0.5, OK, "exploring"),
        (Health(OK, "exploring"), 3.0, OK, "waiting for the arm, for 3 s now"),
        (Health(OK, "exploring"), 12.0, WARN, "waiting for the arm, for 12 s now"),
        (Health(OK, "paused", idle=True), 12.0, OK, "paused"),
        (Health(ERROR, "the disk is full"), 12.0, ERROR, "the disk is full"),
    ],
)
def test_a_long_wait_is_what_a_node_tells_unless_there_is_worse_or_it_is_meant_to_wait(health, seconds, level, message):
    told = with_wait(health, Wait("the arm", seconds))
    assert (told.level, told.message) == (level, message)
    assert ("waiting for" in told.values) == (seconds > 1.0)


def test_one_call_at_a_time_and_the_second_is_told_what_is_being_done():
    activity = ExclusiveTask("fingerprinting")
    with activity.call():
        activity.doing = "reading the model"
        with pytest.raises(BusyError, match=r"fingerprinting is under way \(reading the model\)"), activity.call():
            pass
        assert activity.health().message == "reading the model"
    with pytest.raises(KeyError), activity.call():
        raise KeyError
    health = activity.health(views=3)
    assert (health.message, health.idle) == ("idle", True)
    assert (health.values["calls finished"], health.values["calls failed"], health.values["views"]) == (1, 1, 3)


def test_waits_of_several_threads_do_not_mix_up():
    inside, leave = threading.Barrier(3), threading.Event()

    def wait(name):
        with awaiting(lambda: name):
            inside.wait()
            leave.wait()

    threads = [threading.Thread(target=wait, args=(name,)) for name in ("one", "two")]
    for thread in threads:
        thread.start()
    inside.wait()
    assert longest_wait().what in ("one", "two")
    leave.set()
    for thread in threads:
        thread.join()
    assert longest_wait() is None
