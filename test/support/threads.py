"""Helpers for tests with threads."""

import threading
import time


def in_a_thread(function, *arguments):
    """Call a function in a daemon thread, and return the thread."""
    thread = threading.Thread(target=function, args=arguments, daemon=True)
    thread.start()
    return thread


def wait_for(condition, period=0.002):
    """Return once a condition holds, checked every `period` seconds; fail after ten seconds."""
    ends_at = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < ends_at
        time.sleep(period)


def wait_for_waiter(thread, condition):
    """Return once a thread waits for the next notification of a threading.Condition, or has ended.

    A test that calls it before each tick advances in lock-step with the thread.
    """
    wait_for(lambda: condition._waiters or not thread.is_alive(), 1e-4)
