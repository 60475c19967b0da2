"""What several tests of threads need."""

import threading
import time


def in_a_thread(function, *arguments):
    """Call a function in a thread of its own -> the thread, which does not keep the tests from ending."""
    thread = threading.Thread(target=function, args=arguments, daemon=True)
    thread.start()
    return thread


def wait_for(condition):
    """Return as soon as a condition holds; fail when it does not for ten seconds."""
    ends_at = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < ends_at
        time.sleep(0.002)
