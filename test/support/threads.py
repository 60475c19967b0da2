"""Helpers for tests with threads and processes."""

import threading
import time


def in_a_thread(function, *arguments):
    """Call a function in a daemon thread, and return the thread."""
    thread = threading.Thread(target=function, args=arguments, daemon=True)
    thread.start()
    return thread


def wait_for(condition, period=0.002, timeout=60.0, failure=lambda: "timeout"):
    """Return once a condition holds, checked every `period` seconds; after `timeout` seconds fail with failure()."""
    ends_at = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < ends_at, failure()
        time.sleep(period)


def wait_while_running(process, condition, timeout, failure):
    """Return once a condition holds; fail with failure() if the process ends before, or after `timeout` seconds."""

    def holds():
        held = condition()
        assert held or process.poll() is None, failure()
        return held

    wait_for(holds, 0.05, timeout, failure)


def wait_for_waiter(thread, condition):
    """Return once a thread waits for the next notification of a threading.Condition, or has ended.

    A test that calls it before each tick advances in lock-step with the thread.
    """
    wait_for(lambda: condition._waiters or not thread.is_alive(), 1e-4)
