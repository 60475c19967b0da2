"""Diagnostics: rates on wall time, overruns, waits."""

import threading

import pytest

from embodied_active_learning.errors import BusyError
from embodied_active_learning.ros.planner.step_rate import StepRate
from embodied_active_learning.ros.runtime.diagnostics import ERROR, OK, WARN, Health, Rate, add_wait
from embodied_active_learning.ros.runtime.exclusive_task import ExclusiveTask
from embodied_active_learning.ros.runtime.wait_log import Wait, log_wait, longest_wait


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


def test_rate_covers_window(clock):
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


def test_pace_counts_overruns_but_not_pauses(clock):
    rate = StepRate(0.2, clock)
    for seconds in (0.1, 0.1, 0.5, 0.1, 0.3):
        clock.advance(seconds)
        rate.step()
    values = rate.values()
    assert (values["overruns"], values["last overrun [s]"]) == (2, 0.3)
    rate.interrupt()
    clock.advance(100.0)
    rate.step()
    assert rate.values()["overruns"] == 2


def test_longest_wait_is_the_oldest():
    assert longest_wait() is None
    with log_wait(lambda: "the arm"), log_wait(lambda: "an answer"):
        assert longest_wait().what == "the arm"
    assert longest_wait() is None


def test_wait_ends_on_exception():
    with pytest.raises(KeyError), log_wait(lambda: "the arm"):
        raise KeyError
    assert longest_wait() is None


@pytest.mark.parametrize(
    ("health", "seconds", "level", "message"),
    [
        (Health(OK, "exploring"), 0.5, OK, "exploring"),
        (Health(OK, "exploring"), 3.0, OK, "waiting for the arm for 3 s"),
        (Health(OK, "exploring"), 12.0, WARN, "waiting for the arm for 12 s"),
        (Health(OK, "paused", idle=True), 12.0, OK, "paused"),
        (Health(ERROR, "disk full"), 12.0, ERROR, "disk full"),
    ],
)
def test_wait_becomes_message_of_healthy_busy_node(health, seconds, level, message):
    result = add_wait(health, Wait("the arm", seconds))
    assert (result.level, result.message) == (level, message)
    assert ("waiting for" in result.values) == (seconds > 1.0)


def test_exclusive_task_rejects_second_call():
    task = ExclusiveTask("fingerprinting")
    with task.call():
        task.status = "reading the model"
        with pytest.raises(BusyError, match=r"fingerprinting is already running \(reading the model\)"), task.call():
            pass
        assert task.health().message == "reading the model"
    with pytest.raises(KeyError), task.call():
        raise KeyError
    health = task.health(views=3)
    assert (health.message, health.idle) == ("idle", True)
    assert (health.values["calls finished"], health.values["calls failed"], health.values["views"]) == (1, 1, 3)


def test_waits_of_threads_are_independent():
    inside, leave = threading.Barrier(3), threading.Event()

    def wait(name):
        with log_wait(lambda: name):
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
