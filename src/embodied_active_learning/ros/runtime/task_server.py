"""A long task offered as a service and as an action: one call at a time, with progress, cancelled by its caller.

The action has feedback and a cancel request. A call of the service is cancelled if its caller dies or is interrupted,
or by a request to cancel all goals: `rostopic pub -1 /fingerprint/cancel actionlib_msgs/GoalID {}`.
"""

from __future__ import annotations

import select
import socket
import threading
import time
import traceback
from contextlib import contextmanager
from typing import Any, Callable, Dict, Iterator

import actionlib
import rospy
from actionlib_msgs.msg import GoalID

from embodied_active_learning.errors import EmbodiedActiveLearningError, TaskCancelledError
from embodied_active_learning.ros.runtime.exclusive_task import ExclusiveTask
from embodied_active_learning.ros.runtime.master import CALL_ERRORS
from embodied_active_learning.ros.runtime.node import ShutdownRequestedError
from embodied_active_learning.ros.runtime.services import advertise_service, name_of_caller
from embodied_active_learning.ros.runtime.timers import WallTimer

_POLL_PERIOD = 0.1
"""Wall seconds between checks whether a task was cancelled, during `when_cancelled`."""
_REGISTRATION_PERIOD = 1.0
"""Wall seconds between checks whether the caller of a service is still registered."""
_STATUS_PERIOD = 0.2
"""Wall seconds between messages on the action's status topic: actionlib's default."""


class TaskProgress:
    """Progress of a running task."""

    def __init__(
        self,
        task: ExclusiveTask,
        is_cancelled: Callable[[], bool] = lambda: False,
        publish: Callable[[str, int, int], None] = lambda phase, done, total: None,
    ) -> None:
        """Report to a task's status, and to `publish(phase, done, total)`."""
        self._task = task
        self._is_cancelled = is_cancelled
        self._publish = publish

    def report(self, phase: str, done: int = 0, total: int = 0) -> None:
        """Set the current phase and how much of it is done. Raises TaskCancelledError if the task was cancelled."""
        self._task.status = f"{phase}: {done} of {total}" if total else phase
        self._publish(phase, done, total)
        self.check()

    def check(self) -> None:
        """Raise TaskCancelledError if the task was cancelled, and ShutdownRequestedError if the node ends."""
        if rospy.is_shutdown():
            raise ShutdownRequestedError
        if self._is_cancelled():
            raise TaskCancelledError("cancelled by the caller: nothing was stored")

    @contextmanager
    def when_cancelled(self, callback: Callable[[], None]) -> Iterator[None]:
        """Call callback() from another thread while the task is cancelled but the block has not ended."""
        ended = threading.Event()

        def watch() -> None:
            while not ended.wait(_POLL_PERIOD):
                if self._is_cancelled():
                    callback()

        thread = threading.Thread(target=watch, daemon=True)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()


Run = Callable[[Any, TaskProgress], Dict[str, Any]]
"""Runs the task for a request or goal and returns the fields of the response or result."""


class TaskServer:
    """Serves one task under one name, as a service and as an action with the same fields."""

    def __init__(self, name: str, service_class: Any, action_class: Any, task: ExclusiveTask, run: Run) -> None:
        """Offer the service and the action.

        Args:
            name: Name of the service and of the action.
            service_class: Its response has the fields of the action's result, and `success`.
            action_class: Its result has a field `message`; its feedback has `phase`, `done` and `total`.
            task: Rejects a call while another one is running.
            run: The task. Its EmbodiedActiveLearningErrors become responses without success.
        """
        self._task = task
        self._run = run
        self._service_class = service_class
        self._action_class = action_class
        self._cancelled: Dict[str, threading.Event] = {}
        self._caller = threading.local()
        self._service_cancelled = threading.Event()
        service = advertise_service(name, service_class, self._serve)
        self._keep_connection(service)
        self._actions = actionlib.ActionServer(name, action_class, self._accept, self._cancel, auto_start=False)
        self._actions.start()
        # actionlib publishes the status by simulated time: it would pause with the arm, and end if the clock goes back.
        if self._actions.status_timer is not None:
            self._actions.status_timer.shutdown()
        WallTimer(_STATUS_PERIOD, self._actions.publish_status)
        rospy.Subscriber(f"{name}/cancel", GoalID, self._cancel_service, queue_size=10)

    def _keep_connection(self, service: Any) -> None:
        """Keep the connection of each call: rospy does not pass it to the handler.

        This replaces a private method of rospy, tested with rospy 1.15.15. Without that method, the node fails at
        start with an AttributeError that names it.
        """
        handle = service._handle_request

        def handle_with_connection(transport: Any, request: Any) -> None:
            self._caller.socket = transport.socket
            handle(transport, request)

        service._handle_request = handle_with_connection

    def _serve(self, request: Any) -> Any:
        """Handle a call of the service."""
        connection: socket.socket = self._caller.socket
        with self._task.call():
            self._service_cancelled.clear()
            caller = Caller(name_of_caller(request), connection)
            progress = TaskProgress(self._task, lambda: self._service_cancelled.is_set() or caller.has_left())
            return self._service_class._response_class(success=True, **self._run(request, progress))

    def _cancel_service(self, message: GoalID) -> None:
        """Cancel a call of the service when all goals are cancelled."""
        if not message.id and message.stamp.is_zero():
            self._service_cancelled.set()

    def _accept(self, handle: Any) -> None:
        """Start a goal in a thread of its own."""
        self._cancelled[handle.get_goal_id().id] = threading.Event()
        handle.set_accepted()
        threading.Thread(target=self._execute, args=(handle,), daemon=True).start()

    def _cancel(self, handle: Any) -> None:
        """Request the cancellation of a goal."""
        event = self._cancelled.get(handle.get_goal_id().id)
        if event is not None:
            event.set()

    def _execute(self, handle: Any) -> None:
        """Run a goal to its end and publish the result."""
        identifier = handle.get_goal_id().id
        message = self._action_class()
        make_feedback, make_result = type(message.action_feedback.feedback), type(message.action_result.result)

        def publish(phase: str, done: int, total: int) -> None:
            handle.publish_feedback(make_feedback(phase, done, total))

        try:
            with self._task.call():
                progress = TaskProgress(self._task, self._cancelled[identifier].is_set, publish)
                fields = self._run(handle.get_goal(), progress)
            handle.set_succeeded(make_result(**fields), fields["message"])
        except TaskCancelledError as error:
            rospy.loginfo("%s: %s", identifier, error)
            handle.set_canceled(make_result(message=str(error)), str(error))
        except EmbodiedActiveLearningError as error:
            rospy.logwarn("%s failed: %s", identifier, error)
            handle.set_aborted(make_result(message=str(error)), str(error))
        except ShutdownRequestedError:
            handle.set_aborted(make_result(message="the node is shutting down"), "the node is shutting down")
        except Exception as error:  # otherwise the goal stays active
            rospy.logerr("%s failed: %s", identifier, traceback.format_exc())
            handle.set_aborted(make_result(message=repr(error)), repr(error))
        finally:
            del self._cancelled[identifier]


class Caller:
    """The node that has called the service.

    Ctrl-C in `rosservice call` ends the node but not its connection, because rospy keeps waiting for the response.
    """

    def __init__(self, name: str, connection: socket.socket, clock: Callable[[], float] = time.monotonic) -> None:
        """Name of the node, and the connection of the call. clock: returns the time [s]."""
        self._name = name
        self._connection = connection
        self._clock = clock
        self._was_registered = self._is_registered()
        self._checked_at = clock()

    def has_left(self) -> bool:
        """Return whether the connection was closed, or the node has unregistered from the master since the call."""
        if not is_connected(self._connection):
            return True
        if not self._was_registered or self._clock() < self._checked_at + _REGISTRATION_PERIOD:
            return False
        self._checked_at = self._clock()
        return not self._is_registered()

    def _is_registered(self) -> bool:
        """Whether the master knows the node; also if the master does not respond."""
        try:
            return bool(rospy.get_master().lookupNode(self._name)[0] == 1)
        except CALL_ERRORS:
            return True


def is_connected(connection: socket.socket) -> bool:
    """Return whether the other end of a connection has not closed it; data of a next request is not read."""
    poll = select.poll()
    try:
        poll.register(connection, select.POLLIN)
        return not poll.poll(0) or bool(connection.recv(1, socket.MSG_PEEK))
    except (OSError, ValueError):  # ValueError: closed by this side
        return False
