"""Progress and cancellation of long tasks, without a ROS master."""

from __future__ import annotations

import socket
import threading
from types import SimpleNamespace

import pytest
from embodied_active_learning.msg import IdentifyAction
from embodied_active_learning.srv import Identify

from embodied_active_learning.errors import TaskCancelledError
from embodied_active_learning.ros.runtime import task_server
from embodied_active_learning.ros.runtime.exclusive_task import ExclusiveTask
from embodied_active_learning.ros.runtime.node import ShutdownRequestedError
from embodied_active_learning.ros.runtime.task_server import Caller, TaskProgress, TaskServer, is_connected


def test_progress_sets_status_and_publishes():
    task, published = ExclusiveTask("fingerprinting"), []
    progress = TaskProgress(task, publish=lambda *values: published.append(values))
    progress.report("storing")
    assert task.status == "storing"
    progress.report("object-1", 3, 50)
    assert task.status == "object-1: 3 of 50"
    assert published == [("storing", 0, 0), ("object-1", 3, 50)]


def test_progress_raises_when_cancelled():
    cancelled = threading.Event()
    progress = TaskProgress(ExclusiveTask("fingerprinting"), cancelled.is_set)
    progress.check()
    cancelled.set()
    for action in (progress.check, lambda: progress.report("object-1")):
        with pytest.raises(TaskCancelledError, match="nothing was stored"):
            action()


def test_progress_raises_when_node_ends(monkeypatch):
    monkeypatch.setattr(task_server.rospy, "is_shutdown", lambda: True)
    with pytest.raises(ShutdownRequestedError):
        TaskProgress(ExclusiveTask("fingerprinting")).check()


def test_when_cancelled_calls_back_during_block_only():
    cancelled, called = threading.Event(), threading.Event()
    progress = TaskProgress(ExclusiveTask("fingerprinting"), cancelled.is_set)
    with progress.when_cancelled(called.set):
        pass
    cancelled.set()
    assert not called.is_set()
    with progress.when_cancelled(called.set):
        assert called.wait(60.0)


def test_unexpected_error_aborts_the_goal(monkeypatch):
    for name in ("advertise_service", "WallTimer"):
        monkeypatch.setattr(task_server, name, lambda *_: SimpleNamespace(_handle_request=None))
    actions = SimpleNamespace(start=lambda: None, status_timer=None, publish_status=None)
    monkeypatch.setattr(task_server.actionlib, "ActionServer", lambda *_, **__: actions)
    monkeypatch.setattr(task_server.rospy, "Subscriber", lambda *_, **__: None)

    def fail(goal, progress):
        raise MemoryError("no memory left")

    server = TaskServer("identify", Identify, IdentifyAction, ExclusiveTask("an identification"), fail)
    aborted, ended = [], threading.Event()

    def set_aborted(result, text):
        aborted.append((result.message, text))
        ended.set()

    goal_id = SimpleNamespace(id="goal")
    server._accept(
        SimpleNamespace(
            get_goal_id=lambda: goal_id, get_goal=lambda: None, set_accepted=lambda: None, set_aborted=set_aborted
        )
    )
    assert ended.wait(60.0)
    assert aborted == [("MemoryError('no memory left')",) * 2]


def test_rospy_without_the_replaced_method_is_an_error_at_start(monkeypatch):
    monkeypatch.setattr(task_server, "advertise_service", lambda *_: SimpleNamespace())
    with pytest.raises(AttributeError, match="_handle_request"):
        TaskServer("identify", Identify, IdentifyAction, ExclusiveTask("an identification"), lambda *_: {})


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


class Master:
    """A master that knows some nodes."""

    def __init__(self, *nodes):
        self.nodes = set(nodes)

    def lookupNode(self, name):
        if self.nodes is None:
            raise OSError
        return (1 if name in self.nodes else -1, "", "")


@pytest.fixture
def master(monkeypatch):
    master = Master("/rosservice_1")
    monkeypatch.setattr(task_server.rospy, "get_master", lambda: master)
    return master


def test_interrupted_caller_has_left_although_it_is_connected(master):
    now = [0.0]
    here, _other = socket.socketpair()
    caller = Caller("/rosservice_1", here, lambda: now[0])
    now[0] = 10.0
    assert not caller.has_left()
    master.nodes.clear()
    now[0] = 20.0
    assert caller.has_left()


def test_caller_is_kept_while_master_is_silent_or_never_knew_it(master):
    now = [0.0]
    here, _other = socket.socketpair()
    known, unknown = (Caller(name, here, lambda: now[0]) for name in ("/rosservice_1", "/a_script"))
    master.nodes = None
    now[0] = 10.0
    assert not known.has_left()
    assert not unknown.has_left()
