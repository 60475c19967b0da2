"""Progress and cancellation of long tasks, without a ROS master."""

from __future__ import annotations

import socket
import threading

import pytest

from embodied_active_learning.errors import TaskCancelledError
from embodied_active_learning.ros.runtime.exclusive_task import ExclusiveTask
from embodied_active_learning.ros.runtime.task_server import Progress, is_connected


def test_progress_sets_status_and_publishes():
    task, published = ExclusiveTask("fingerprinting"), []
    progress = Progress(task, publish=lambda *values: published.append(values))
    progress.report("storing")
    assert task.status == "storing"
    progress.report("object-1", 3, 50)
    assert task.status == "object-1: 3 of 50"
    assert published == [("storing", 0, 0), ("object-1", 3, 50)]


def test_progress_raises_when_cancelled():
    cancelled = threading.Event()
    progress = Progress(ExclusiveTask("fingerprinting"), cancelled.is_set)
    progress.check()
    cancelled.set()
    for action in (progress.check, lambda: progress.report("object-1")):
        with pytest.raises(TaskCancelledError, match="nothing was stored"):
            action()


def test_when_cancelled_calls_back_during_block_only():
    cancelled, called = threading.Event(), threading.Event()
    progress = Progress(ExclusiveTask("fingerprinting"), cancelled.is_set)
    with progress.when_cancelled(called.set):
        pass
    cancelled.set()
    assert not called.is_set()
    with progress.when_cancelled(called.set):
        assert called.wait(60.0)


def test_connection_is_lost_when_caller_closes():
    here, caller = socket.socketpair()
    with here:
        with caller:
            assert is_connected(here)
            caller.send(b"next request")
            assert is_connected(here)
            assert here.recv(100) == b"next request"
        assert not is_connected(here)
    assert not is_connected(here)
