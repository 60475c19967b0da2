"""Arm and camera for a node that moves and observes in turns; failures are outlasted, and a pause is possible."""

from __future__ import annotations

import threading
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from dataclasses import replace
from typing import Callable, NamedTuple, Optional, Sequence, Tuple, Union

import numpy as np
import rospy
from sensor_msgs.msg import Image

from embodied_active_learning.config import Config
from embodied_active_learning.errors import (
    ArmBusyError,
    ArmStoppedError,
    CommandError,
    EmbodiedActiveLearningError,
    NoResponseError,
    ObservationError,
)
from embodied_active_learning.exploration.commands import Command, PoseCommand, VelocityCommand
from embodied_active_learning.msg import PlanarState
from embodied_active_learning.ros.arm.client import ArmClient
from embodied_active_learning.ros.arm.lease import Lease
from embodied_active_learning.ros.arm.restore_point import RestorePoint
from embodied_active_learning.ros.arm.retry_policy import RETRY_PERIOD, RetryPolicy
from embodied_active_learning.ros.camera.posed_camera import PosedCamera
from embodied_active_learning.ros.conversions import state_arrays
from embodied_active_learning.ros.runtime.diagnostics import ERROR, WARN, Health
from embodied_active_learning.ros.runtime.log_throttle import LogThrottle
from embodied_active_learning.ros.runtime.node import wait_until, wall_sleep

STOP_TIMEOUT = 10.0
"""Wall seconds within which the arm should finish a command and stop."""


class _Restore(NamedTuple):
    """Command to return a simulated arm to a state that it has published."""

    state: PlanarState


_AnyCommand = Union[Command, _Restore]


class RetryingArm:
    """Executes commands and takes images; holds the arm still while something fails.

    `go_to` repeats its command until the arm arrives. `execute` does not: after a failure it holds the arm still, and
    the caller plans again from where the arm is. Up to arm/retries failures in a row are tolerated (see RetryPolicy).
    Stale images, a stopped arm, another commander and a missing response are waited for. A stopped arm is never
    recovered from here. A simulated arm that has restarted returns to its last state before the next command.

    One thread moves and observes; any thread may call pause, resume and stop, and read the properties.
    """

    def __init__(self, config: Config, timeout: Optional[float] = None) -> None:
        """Raise the last failure after `timeout` wall seconds of failures in one call; None retries forever.

        The response to an accepted command is awaited beyond the timeout.
        """
        self._camera = PosedCamera(config)
        self._arm = ArmClient()
        self._restore_point = RestorePoint(self._arm, self._camera)
        self._lease = Lease(config.arm.commander_timeout, self._arm.heartbeat)
        self._retry = RetryPolicy(config.arm.retries, timeout)
        self._arm_lock = threading.Lock()  # held during a call of the arm's services
        self._running = threading.Event()
        self._running.set()
        self._waiting_for = ""
        self._was_held = False
        self._error = ""
        self._throttle = LogThrottle()
        self._hold = VelocityCommand(0.0, 0.0, 0.0, config.exploration.step_duration)

    @property
    def hold(self) -> VelocityCommand:
        """The command that holds the arm still for one exploration step."""
        return self._hold

    def health(self, active: Health) -> Health:
        """Return the diagnostic status: paused, held still and why, or else `active`."""
        if self.is_paused:
            return replace(active, level=WARN, message=f"paused, waiting for {self._waiting_for}", idle=True)
        if self._error:
            return replace(active, level=ERROR, message=f"arm held still: {self._error}")
        return active

    @property
    def was_held(self) -> bool:
        """Whether the arm was held still since the last call of execute or go_to began."""
        return self._was_held

    @property
    def in_control(self) -> bool:
        """Whether the arm is where this node's last command has left it, as far as this node knows."""
        if not self._is_restorable:
            return self._lease.is_held
        return not self._restore_point.is_moved_by_others

    @property
    def is_paused(self) -> bool:
        """Whether commands are held back."""
        return not self._running.is_set()

    def wait(self, check: Callable[[], None] = lambda: None) -> None:
        """Wait for the arm's services, images and states; check() gives up by raising.

        Raises ShutdownRequestedError.
        """
        self._arm.wait(check)
        wait_until(lambda: self._camera.connected, lambda: "publishers of images and arm states", check=check)

    def observe(self, reached: PlanarState) -> Tuple[Image, PlanarState]:
        """Return the first image since a state was reached, as published, and the state it was taken from.

        Raises:
            ObservationError, CommandError: Timeout or retries are used up.
            ShutdownRequestedError: The node ends.
        """
        self._retry.begin_call()
        restored = False
        while True:
            try:
                observation = self._camera.take(reached.header.stamp)
                if self._is_restorable and observation[0].header.stamp != reached.header.stamp:
                    raise ObservationError(
                        "image stamp differs from the arm state: the simulated arm has moved or restarted"
                    )
                break
            except ObservationError as error:
                if self._is_restorable and (self._restore_point.must_restore or not restored):
                    # The simulation publishes the image again; this does not count as holding the arm still.
                    reached = self._execute(_Restore(self._restore_point.state), self._hold)
                    restored = True
                    continue
                self._wait_for_retry(error)
                self._was_held = True
                reached = self._execute(self._hold, self._hold)
        self._error = ""
        return observation

    def execute(self, command: Command) -> PlanarState:
        """Carry out a command, or hold still if it fails or was planned before a pause; return the state reached.

        Raises CommandError when timeout or retries are used up, and ShutdownRequestedError.
        """
        self._was_held = False
        self._retry.begin_call()
        return self._execute(command, self._hold)

    def go_to(self, pose: Sequence[float]) -> PlanarState:
        """Move to pose (3,) [m, m, rad], retrying until the arm arrives; return the state reached.

        Raises CommandError when timeout or retries are used up, and ShutdownRequestedError.
        """
        self._was_held = False
        self._retry.begin_call()
        command = PoseCommand(*map(float, pose))
        reached = self._execute(command, command)
        self._error = ""
        return reached

    def restore(self, state: PlanarState) -> PlanarState:
        """Return a simulated arm to a state that it has published; return that state.

        Raises CommandError when the arm cannot, or timeout or retries are used up, and ShutdownRequestedError.
        """
        self._retry.begin_call()
        reached = self._execute(_Restore(state), None)
        self._error, self._was_held = "", False
        return reached

    def stop(self, timeout: float = STOP_TIMEOUT) -> None:
        """Stop the arm after the command in progress and release control; without control nothing is stopped.

        Raises CommandError if the arm has not confirmed within `timeout` wall seconds; it then stops once it responds.
        """
        # In a thread, because a service call cannot be cancelled.
        outcome: Future = Future()
        threading.Thread(target=self._release, args=(outcome,), daemon=True).start()
        try:
            outcome.result(timeout)
        except FutureTimeoutError as error:
            raise CommandError(f"the arm has not responded within {timeout:g} s") from error

    def cancel(self) -> None:
        """Stop the command in progress, so that the current call raises its error without a retry; from any thread."""
        self._retry.cancel()
        try:
            self._arm.stop_if_commander()  # without the lock, which the command in progress holds
        except CommandError as error:
            rospy.logwarn("stop not confirmed: %s", error)

    def pause(self, waiting_for: str) -> None:
        """Hold back all further commands.

        The command in progress continues: call stop to make the arm stand still. waiting_for: shown in diagnostics.
        """
        self._waiting_for = waiting_for
        self._running.clear()

    def resume(self) -> None:
        """Allow commands again."""
        self._running.set()

    def wait_while_paused(self) -> bool:
        """Wait until commands are allowed; return whether that took waiting. Raises ShutdownRequestedError."""
        if not self.is_paused:
            return False
        wait_until(self._running.is_set, lambda: self._waiting_for)
        return True

    def _execute(self, command: _AnyCommand, fallback: Optional[_AnyCommand]) -> PlanarState:
        """Carry out a command; after a failure or a pause carry out the fallback until it succeeds.

        Without a fallback the command itself is retried, unless it is rejected. A simulated arm that does not respond
        is waited for until the timeout and restored, after which the command itself is retried.
        """
        while True:
            if self.wait_while_paused():
                command, self._was_held = fallback or command, True
            try:
                with self._arm_lock:
                    if self.is_paused:
                        continue
                    reached = self._send(command)
            except CommandError as error:
                if self._is_restorable and isinstance(error, NoResponseError):
                    self._restore_point.set_response_missing(True)
                    self._wait_for_retry(error)
                elif fallback is None and type(error) is CommandError:
                    raise
                else:
                    self._wait_for_retry(error)
                    command, self._was_held = fallback or command, True
            else:
                if command is not self._hold:
                    self._retry.reset()
                return reached

    @property
    def _is_restorable(self) -> bool:
        """Whether the arm is simulated and can return to where the last command has left it."""
        return self._restore_point.state is not None

    def _send(self, command: _AnyCommand) -> PlanarState:
        """Carry out a command; a simulated arm that is not where it was left is restored first."""
        if self._restore_point.must_restore:
            self._restore_last_state()
        reached = self._call(command)
        before = None if isinstance(command, _Restore) else self._restore_point.state
        if before is not None and reached.header.stamp <= before.header.stamp:
            raise NoResponseError("the simulated arm has restarted: its time went back")
        self._restore_point.set_reached(reached)
        return reached

    def _restore_last_state(self) -> None:
        """Restore the state of the last command. Raises CommandError; if it is lost, the arm is used where it is."""
        try:
            self._call(_Restore(self._restore_point.state))
        except (ArmBusyError, ArmStoppedError, NoResponseError):
            raise
        except CommandError:
            self._restore_point.lose()
            self._lease.end()
            raise

    def _call(self, command: _AnyCommand) -> PlanarState:
        restarts = self._camera.restarts
        try:
            if isinstance(command, _Restore):
                reached = self._restore(command.state)
            elif isinstance(command, VelocityCommand):
                reached = self._arm.move(command.velocity.tolist(), command.duration)
            else:
                reached = self._arm.go_to((command.x, command.y, command.theta))
        except (ArmBusyError, ArmStoppedError):
            raise
        except CommandError:
            self._lease.renew()  # the arm has accepted us as its commander, or may have
            raise
        self._lease.renew()
        self._restore_point.set_called(restarts)
        return reached

    def _restore(self, state: PlanarState) -> PlanarState:
        reached = self._arm.restore(state.header.stamp)
        if not np.array_equal(state_arrays(reached)[0], state_arrays(state)[0]):
            raise CommandError(
                f"restore failed: the arm's state at {state.header.stamp.to_sec():.3f} s is not the requested one"
            )
        rospy.loginfo("simulated arm restored to its state at %.3f s", state.header.stamp.to_sec())
        self._restore_point.set_response_missing(False)
        return reached

    def _release(self, outcome: Future) -> None:
        try:
            with self._arm_lock:
                if self.in_control:
                    self._arm.stop_if_commander(without_response=True)
                self._lease.end()
                self._restore_point.release()
            outcome.set_result(None)
        except CommandError as error:
            outcome.set_exception(error)

    def _wait_for_retry(self, error: EmbodiedActiveLearningError) -> None:
        """Report a failure and wait until the retry is due. Raises the error if it is not retried any more."""
        try:
            due = self._retry.after(error)
        except EmbodiedActiveLearningError:
            self._error = ""
            raise
        if not self._error:
            self._throttle.reset()
        self._error = due.message
        delay = min(due.pause, RETRY_PERIOD)
        wall_sleep(delay)  # before the log: when all nodes are ended, the arm often ends first
        if self._throttle.should_log(due.message):
            rospy.logwarn("arm held still: %s", due.message)
        wall_sleep(due.pause - delay)
