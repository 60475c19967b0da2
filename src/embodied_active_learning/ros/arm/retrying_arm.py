"""Arm and camera as a node uses them that moves and looks by turns: with patience, and pausable from outside."""

from __future__ import annotations

import math
import threading
import time
from concurrent.futures import Future
from concurrent.futures import TimeoutError as NotInTimeError
from dataclasses import replace
from typing import NamedTuple, Optional, Sequence, Tuple, Union

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
from embodied_active_learning.ros.arm.client import ArmClient, Reached
from embodied_active_learning.ros.arm.lease import Lease
from embodied_active_learning.ros.camera.posed_camera import PosedCamera
from embodied_active_learning.ros.runtime.diagnostics import ERROR, WARN, Health
from embodied_active_learning.ros.runtime.log_throttle import LogThrottle
from embodied_active_learning.ros.runtime.node import wait_until, wall_sleep

RETRY_PERIOD = 0.5
"""Wall seconds between two tries; doubled with each failure of the arm in a row ..."""
LONGEST_RETRY_PERIOD = 8.0
"""... up to this."""
WAITED_FOR = (ObservationError, ArmBusyError, ArmStoppedError, NoResponseError)
"""What only time or a person can mend; trying again costs nothing, so it is not counted."""
STOP_TIMEOUT = 10.0
"""Wall seconds within which an arm is expected to finish a command and stop."""


class _PutBack(NamedTuple):
    """The command to be where a simulated arm was when its memory was this."""

    memory: np.ndarray


class RetryingArm:
    """Moves and looks. What fails is said, and again every few seconds; the arm is held still and it is tried again.

    Commands that the arm refuses or fails to do are tried arm/retries times in a row, then given up. What only time or
    a person can mend is waited for: images that are not fresh, a stopped arm, another driver, no answer at all. A
    stopped arm is never recovered from here. A simulated arm that was started anew is put back to where it was left.

    One thread moves and looks; any thread may call pause, resume and stop, and read the properties.
    """

    def __init__(self, config: Config, patience: Optional[float] = None) -> None:
        """Patience: wall seconds of failures after which a call raises the last one; None waits for ever.

        An arm that has taken a command is waited for until it answers, whatever the patience.
        """
        self._patience = math.inf if patience is None else patience
        self._retries = config.arm.retries
        self._camera = PosedCamera(config)
        self._arm = ArmClient()
        self._lease = Lease(config.arm.commander_timeout, self._arm.keep)
        self._turn = threading.Lock()  # held by the thread that talks to the arm
        self._switch = threading.Lock()
        self._going = threading.Event()
        self._going.set()
        self._awaited = ""
        self._memory = np.empty(0)
        self._left_at = rospy.Time()  # when the last command has left the arm
        self._restarts = 0
        self._unanswered = False
        self._failures = 0  # of the arm, since it last carried out more than standing still
        self._held = False
        self._trouble = ""
        self._repeats = LogThrottle()
        self._standing = VelocityCommand(0.0, 0.0, 0.0, config.exploration.step_duration)

    @property
    def standing(self) -> VelocityCommand:
        """The command that holds the arm still for the time of one exploration step."""
        return self._standing

    @property
    def trouble(self) -> str:
        """Why the arm is held still; empty when it goes on."""
        return self._trouble

    def health(self, going: Health) -> Health:
        """What /diagnostics tells: that the arm is paused or held still, and why; else what is going on."""
        if self.is_paused:
            return replace(going, level=WARN, message=f"paused, waiting for {self._awaited}", idle=True)
        if self._trouble:
            return replace(going, level=ERROR, message=f"the arm stands still: {self._trouble}")
        return going

    @property
    def held(self) -> bool:
        """Whether anything was held still for since the last call of execute or go_to began."""
        return self._held

    @property
    def is_ours(self) -> bool:
        """Whether the arm is where this node's last command has left it, as far as this node can tell."""
        if not self._memory.size:
            return self._lease.is_held
        # Simulated time passes only while the arm moves: states tell whether it did, however long ago the command is.
        newest = self._camera.newest_state
        return self._is_lost or newest is None or newest <= self._left_at

    @property
    def memory(self) -> np.ndarray:
        """(M,) what puts a simulated arm back to where the last command has left it; empty for a real one."""
        return self._memory

    @property
    def is_paused(self) -> bool:
        """Whether commands are held back."""
        return not self._going.is_set()

    def wait(self) -> None:
        """Return once arm and camera are there. Raises ShutdownRequestedError."""
        self._arm.wait()
        wait_until(lambda: self._camera.connected, lambda: "publishers of images and arm states")

    def look(self, reached: PlanarState) -> Tuple[Image, PlanarState]:
        """The first image since a state was reached -> (image as published, state it was taken from).

        Raises ObservationError or CommandError when patience or tries have ended, and ShutdownRequestedError.
        """
        gives_up_at = time.monotonic() + self._patience
        asked_again = False
        while True:
            try:
                seen = self._camera.take(reached.header.stamp)
                break
            except ObservationError as error:
                if self._memory.size and (self._is_lost or not asked_again):
                    # A simulated arm shows once more what it has shown, or was lost with it: nothing has happened then.
                    reached = self._insist(_PutBack(self._memory), self._standing, gives_up_at)
                    asked_again = True
                    continue
                self._bear(error, gives_up_at)
                reached = self._insist(self._standing, self._standing, gives_up_at)
        self._trouble = ""
        return seen

    def execute(self, command: Command) -> PlanarState:
        """Carry out a command, or hold still instead when it fails or was planned before a pause -> the state reached.

        Raises CommandError when patience or tries have ended, and ShutdownRequestedError.
        """
        self._held = False
        return self._insist(command, self._standing, time.monotonic() + self._patience)

    def go_to(self, pose: Sequence[float]) -> PlanarState:
        """Go to pose (3,) [m, m, rad], trying until the arm gets there -> the state reached.

        Raises CommandError when patience or tries have ended, and ShutdownRequestedError.
        """
        self._held = False
        command = PoseCommand(*map(float, pose))
        reached = self._insist(command, command, time.monotonic() + self._patience)
        self._trouble = ""
        return reached

    def put_back(self, memory: np.ndarray) -> PlanarState:
        """Put a simulated arm back to where it was when its memory (M,) was this -> that state.

        Raises CommandError when tries or patience have ended, and ShutdownRequestedError.
        """
        command = _PutBack(memory)
        reached = self._insist(command, command, time.monotonic() + self._patience)
        self._trouble, self._held = "", False
        return reached

    def stop(self, timeout: float = STOP_TIMEOUT) -> None:
        """Stop the arm behind the command under way, and give it back; an arm that is not ours is left alone.

        Raises CommandError when that is not certain after timeout [s of wall time]; it happens then as soon as the arm
        answers.
        """
        # In a thread, because no call of a service can be given up.
        outcome: Future = Future()
        threading.Thread(target=self._give_back, args=(outcome,), daemon=True).start()
        try:
            outcome.result(timeout)
        except NotInTimeError as error:
            raise CommandError(f"the arm has not answered within {timeout:g} s") from error

    def pause(self, awaited: str) -> bool:
        """Hold back every command from now on, saying what is awaited -> False when it was so already.

        The command under way goes on: call stop to have the arm stand still.
        """
        with self._switch:
            changed = not self.is_paused
            self._awaited = awaited
            self._going.clear()
            return changed

    def resume(self) -> bool:
        """Let commands through again -> False when nothing was paused."""
        with self._switch:
            changed = self.is_paused
            self._going.set()
            return changed

    def wait_while_paused(self) -> bool:
        """Return as soon as commands are let through -> whether that took waiting. Raises ShutdownRequestedError."""
        if not self.is_paused:
            return False
        wait_until(self._going.is_set, lambda: self._awaited)
        return True

    def _insist(
        self, command: Union[Command, _PutBack], instead: Union[Command, _PutBack], gives_up_at: float
    ) -> PlanarState:
        """Carry out a command; when it fails, or a pause came before it, then another one until that succeeds.

        A simulated arm that does not answer is waited for, put back, and none the worse for it.
        """
        while True:
            if self.wait_while_paused():
                command, self._held = instead, True
            try:
                with self._turn:
                    if self.is_paused:
                        continue
                    reached = self._send(command)
            except CommandError as error:
                if self._memory.size and isinstance(error, NoResponseError):
                    self._unanswered = True
                    self._stand_still(str(error))
                    wall_sleep(RETRY_PERIOD)
                else:
                    self._bear(error, gives_up_at)
                    command = instead
            else:
                if command is not self._standing:
                    self._failures = 0
                return reached

    @property
    def _is_lost(self) -> bool:
        """Whether a simulated arm has begun anew since the last command, or may have."""
        return bool(self._memory.size) and (self._unanswered or self._camera.restarts != self._restarts)

    def _send(self, command: Union[Command, _PutBack]) -> PlanarState:
        """Carry out a command; a simulated arm that was lost is put back first."""
        if self._is_lost:
            self._call(_PutBack(self._memory))
        reached = self._call(command)
        time_went_back = self._memory.size and reached.state.header.stamp <= self._left_at
        if time_went_back and not isinstance(command, _PutBack):
            raise NoResponseError("the simulated arm was started anew: another one has answered")
        self._memory, self._left_at = reached.memory, reached.state.header.stamp
        return reached.state

    def _call(self, command: Union[Command, _PutBack]) -> Reached:
        restarts = self._camera.restarts
        try:
            if isinstance(command, _PutBack):
                reached = self._arm.restore(command.memory)
                rospy.loginfo("the simulated arm was put back to where it was left")
                self._unanswered = False
            elif isinstance(command, VelocityCommand):
                reached = self._arm.move(command.velocity, command.duration)
            else:
                reached = self._arm.go_to((command.x, command.y, command.theta))
        except (ArmBusyError, ArmStoppedError):
            raise
        except CommandError:
            self._lease.renew()  # the arm listened to us, or may have
            raise
        self._lease.renew()
        self._restarts = restarts
        return reached

    def _give_back(self, outcome: Future) -> None:
        try:
            with self._turn:
                # The arm takes a stop by anybody but its driver for an emergency, and one that was started anew has
                # no driver: so it is asked first.
                if self.is_ours and self._may_be_kept():
                    self._arm.stop()
                self._lease.end()
            outcome.set_result(None)
        except CommandError as error:
            outcome.set_exception(error)

    def _may_be_kept(self) -> bool:
        """Whether the arm knows this node as its driver, or does not say: a node that ends gets no answers any more."""
        try:
            return self._arm.keep()
        except CommandError:
            return True

    def _bear(self, error: EmbodiedActiveLearningError, gives_up_at: float) -> None:
        """Say what is wrong and wait for the next try; raise it when patience or tries have ended."""
        trouble, wait = str(error), RETRY_PERIOD
        if not isinstance(error, WAITED_FOR):
            self._failures += 1
            tries = self._failures
            if tries > self._retries:
                self._failures, self._trouble = 0, ""
                raise type(error)(f"{error} (gave up after {tries} tries)") from error
            wait = min(RETRY_PERIOD * 2 ** (tries - 1), LONGEST_RETRY_PERIOD)
            trouble += f" (try {tries} of {self._retries + 1}, the next in {wait:g} s)"
        if time.monotonic() >= gives_up_at:
            self._failures, self._trouble = 0, ""
            raise error
        self._held = True
        self._stand_still(trouble)
        wall_sleep(max(0.0, min(wait, gives_up_at - time.monotonic())))

    def _stand_still(self, trouble: str) -> None:
        """Say what is wrong when it is new, and again every few seconds."""
        if not self._trouble:
            self._repeats.reset()
        if self._repeats.should_log(trouble):
            rospy.logwarn("the arm stands still: %s", trouble)
        self._trouble = trouble
