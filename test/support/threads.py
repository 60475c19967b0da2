"""Helpers for tests with threads."""

import threading
import time


def in_a_thread(function, *arguments):
    """Call a function in a daemon thread, and return the thread."""
    thread = threading.Thread(target=function, args=arguments, daemon=True)
    thread.start()
    return thread


def wait_for(condition):
    """Return once a condition holds; fail after ten seconds."""
    ends_at = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < ends_at
        time.sleep(0.002)
