"""Carries out commands by set-points, one a tick: what lies between the arm's services and the robot, without ROS.

Three kinds of threads meet here: one ticks, one brings the robot's states, and those that give commands wait. Whatever
goes wrong, nothing is integrated any more and no set-point is sent: the controller then holds the last one, which is
within franka/max_lead of the arm along each axis.
"""

from __future__ import annotations

import math
import threading
import time
from typing import Callable, Dict, List, NamedTuple, Optional, Protocol, Sequence, Tuple

import numpy as np

from embodied_active_learning.arm_requests import checked_duration, checked_pose, checked_velocity
from embodied_active_learning.config import Config
from embodied_active_learning.errors import (
    ArmFailedError,
    ArmNotReadyError,
    ArmStoppedError,
    ObservationError,
)
from embodied_active_learning.franka.mount import CameraMount, CameraPose
from embodied_active_learning.franka.readiness import Condition, Readiness, Report
from embodied_active_learning.franka.set_points import SetPointStream, Step
from embodied_active_learning.franka.state_track import StateTrack
from embodied_active_learning.workspace import STATE_NAMES

AT_REST = (0.005, 0.005, 0.03)
"""m/s, m/s, rad/s: a measured velocity that is no motion."""
_LATEST_TICK = 0.5  # s without a tick after which a command is given up
_SETTLING = 4.0  # s that an impedance controller may take to draw the arm to its last set-point
_LEFT, _TURN_LEFT = 1e-4, 1e-3  # m, rad: a set-point that is no farther from a target is at it
_STOPPING = 3.0  # s within which an arm that brakes has to come to rest; less than a node has to end
_LOOK = 0.05  # s, at most, between two looks of a waiting command
_FOR_PERSONS = (Condition.USER_STOPPED, Condition.GUIDED, Condition.HELD)


class StopSignal(Protocol):
    """Set when a node stops the arm during a command."""

    @property
    def by(self) -> str:
        """Name of that node."""

    def is_set(self) -> bool:
        """Whether the command must end."""


class Reached(NamedTuple):
    """The measured state that a command ended with."""

    stamp: float  # s, the robot's
    pose: Tuple[float, ...]  # (3,) m, m, rad
    velocity: Tuple[float, ...]  # (3,) m/s, m/s, rad/s
    limited: bool


class _Command:
    """What the ticks are to do, and what has become of it."""

    def __init__(self) -> None:
        self.why_broken_off = ""
        self.for_person = False
        self.limited = False

    def tick(self, stream: SetPointStream, measured: CameraPose, period: float) -> Step:
        """Have the set-point come to rest."""
        return stream.brake(measured, period)


class _Move(_Command):
    def __init__(self, velocity: List[float], ends_at: float, clock: Callable[[], float]) -> None:
        super().__init__()
        self._velocity, self._ends_at, self._clock = velocity, ends_at, clock

    def tick(self, stream: SetPointStream, measured: CameraPose, period: float) -> Step:
        if self._clock() >= self._ends_at:  # nobody has gone on from it
            return stream.brake(measured, period)
        step = stream.advance(self._velocity, measured, period)
        self.limited |= step.cut
        return step


class _GoTo(_Command):
    def __init__(self, target: Sequence[float]) -> None:
        super().__init__()
        self._target = target

    def tick(self, stream: SetPointStream, measured: CameraPose, period: float) -> Step:
        return stream.advance(stream.approach(self._target, period), measured, period)


class _Retreat(_Command):
    def tick(self, stream: SetPointStream, measured: CameraPose, period: float) -> Step:
        return stream.retreat(measured, period)


class FrankaDriver:
    """Moves the arm on behalf of one command at a time; see_state and tick are called by other threads meanwhile."""

    def __init__(self, config: Config, clock: Callable[[], float] = time.monotonic) -> None:
        self._config = config
        self._clock = clock
        self._workspace = config.workspace.box()
        self._mount = CameraMount.from_config(config)
        self._track = StateTrack(config)
        self._stream = SetPointStream(config)
        self._changed = threading.Condition()
        self._readiness = Readiness(config.franka, clock)
        self._report = Report()
        self._seen_at: Optional[float] = None
        self._stamp = 0.0
        self._jump = ""
        self._command = _Command()
        self._ticked_at = clock()
        self._pulled = False
        self.jumps = 0
        self.yields = 0

    @property
    def readiness(self) -> Readiness:
        """What the robot is in; to be used with the lock held, see with_readiness."""
        return self._readiness

    @property
    def lock(self) -> threading.Condition:
        """Held by whoever uses readiness."""
        return self._changed

    def update_state(
        self,
        stamp: float,
        delay: float,
        end_effector: Sequence[float],
        mode: int,
        errors: Sequence[str],
        last_errors: Sequence[str],
    ) -> Optional[Reached]:
        """Take in a state: its stamp and its delay, s, O_T_EE (16,) column by column, and what the robot says is wrong.

        -> where the camera is by it; None when that cannot be told, and when the state is no new one.
        """
        with self._changed:
            if not self._track.is_new(stamp):
                return None
            self._seen_at = self._clock()
            trouble = ""
            try:
                pose = self._mount.camera_pose(end_effector)
            except ObservationError as error:
                trouble = str(error)
            else:
                self._follow(stamp, pose)
            self._report = self._report._replace(
                trouble=trouble, mode=mode, errors=tuple(errors), last_errors=tuple(last_errors), delay=delay
            )
            self._stamp = stamp
            self._changed.notify_all()
            return None if trouble else self._reached(False)

    def update_control(self, **fields: object) -> None:
        """Take in what is known of controllers, rivals, heard: fields of Report."""
        with self._changed:
            self._report = self._report._replace(**fields)
            self._look()
            self._changed.notify_all()

    def tick(self) -> Optional[CameraPose]:
        """Go on by the wall time since the last tick -> the set-point to send; None: send none."""
        with self._changed:
            now = self._clock()
            period, self._ticked_at = now - self._ticked_at, now
            try:
                return self._set_point(period)
            finally:
                self._changed.notify_all()

    def move(self, velocity: Sequence[float], duration: float, stop: StopSignal) -> Reached:
        """Hold velocity (3,) m/s, m/s, rad/s for a duration, s of wall time, as far as limits allow -> the state then.

        The arm keeps the velocity for franka/coast more, so that the next move goes on from it, and then brakes by
        itself. Raises CommandError for what no arm should be told, ArmNotReadyError or ArmStoppedError when the robot
        takes no command, ArmFailedError and ArmStoppedError when it stops doing it.
        """
        wanted = checked_velocity(velocity)
        duration = checked_duration(duration, self._config.arm.max_duration)
        with self._changed:
            ends_at = self._clock() + duration
            command = _Move(wanted, ends_at + self._config.franka.coast, self._clock)
            self._begin(command)
            while self._clock() < ends_at:
                self._wait(command, stop, ends_at)
            limits = self._stream.limits
            limited = command.limited or limits.differ(self._stream.velocity, limits.slowed(wanted))
            return self._reached(limited)

    def go_to(self, pose: Sequence[float], stop: StopSignal) -> Reached:
        """Go straight to a planar pose (3,) m, m, rad within the limits and stop there -> the state then.

        Raises CommandError for a pose outside the workspace, ArmFailedError when the arm does not get there in time;
        else as move.
        """
        limits = self._stream.limits
        target = np.clip(checked_pose(pose, self._workspace), limits.lower, limits.upper).tolist()
        with self._changed:
            command = _GoTo(target)
            self._begin(command)
            here = self._measured().planar
            began_at = self._clock()
            allowed = _SETTLING + 2.0 * (limits.braking_time(self._stream.velocity) + limits.travel_time(here, target))
            while not self._has_arrived(target):
                self._wait(command, stop, began_at + allowed)
                if self._clock() >= began_at + allowed:
                    self._command = _Command()
                    raise ArmFailedError(self._why_not_reached(target, allowed))
            self._command = _Command()
            return self._reached(False)

    def stop(self) -> Reached:
        """Come to rest, whatever the robot is in -> the state then.

        Raises ArmFailedError when that cannot be told, or does not happen.
        """
        with self._changed:
            command = self._command = _Retreat()
            try:
                self._wait_for_rest()
            finally:
                if self._command is command:  # a set-point that went on after the arm would let it be drawn anywhere
                    self._command = _Command()
            return self._reached(False)

    def wait_until_ready(self, timeout: float) -> bool:
        """Whether the robot is ready within a timeout, s."""
        with self._changed:
            ends_at = self._clock() + timeout
            while not self._look().is_ready and self._clock() < ends_at:
                self._pause(_LOOK)
            return self._readiness.is_ready

    def values(self) -> Dict[str, object]:
        """Return the figures for /diagnostics."""
        lead = self.lead()
        with self._changed:
            readiness = self._readiness
            return {
                "robot": readiness.condition.value,
                "mode": readiness.mode_in_words,
                "errors": readiness.errors_in_words,
                "age of the newest state [s]": readiness.age_in_words,
                "controllers": readiness.controllers_in_words,
                "recoveries": readiness.recoveries,
                "recoveries in a row": readiness.recoveries_in_a_row,
                "set-point ahead [m, rad]": "-" if lead is None else f"{lead[0]:.3f}, {lead[1]:.2f}",
                "set-point drawn after the arm": self.yields,
                "pose jumps": self.jumps,
            }

    def why_not_ready(self) -> str:
        """A sentence on what keeps the arm from moving; empty when nothing does."""
        with self._changed:
            return self._look().why_not_ready

    def lead(self) -> Optional[Tuple[float, float]]:
        """How far the set-point is from the arm, m and rad; None while none is sent."""
        with self._changed:
            measured = self._track.pose
            return None if measured is None or self._stream.set_point is None else self._stream.lead(measured)

    def is_at_rest(self) -> bool:
        """Whether set-point and arm stand still, as far as states tell."""
        with self._changed:
            return self._is_at_rest()

    def _follow(self, stamp: float, pose: CameraPose) -> None:
        try:
            self._track.add(stamp, pose)
        except ObservationError as error:
            self._jump = str(error)
            self.jumps += 1

    def _is_at_rest(self) -> bool:
        fresh = self._look().condition not in (Condition.AWAITED, Condition.SILENT, Condition.UNUSABLE)
        still = all(abs(speed) <= limit for speed, limit in zip(self._track.velocity, AT_REST))
        slow = all(abs(speed) <= limit for speed, limit in zip(self._stream.velocity, AT_REST))
        return fresh and self._track.tells_motion and still and slow

    def _set_point(self, period: float) -> Optional[CameraPose]:
        measured = self._track.pose
        if not self._look().is_ready or measured is None:
            self._stream.end()
            self._break_off(self._readiness.why_not_ready, self._readiness.condition in _FOR_PERSONS)
            self._jump = ""
            return None
        if self._jump:
            self._stream.end()
            self._break_off(self._jump)
            self._jump = ""
        if self._stream.set_point is None:
            self._stream.begin(measured)
        elif period > 0.0:
            pulled = self._command.tick(self._stream, measured, period).pulled
            self.yields += pulled and not self._pulled
            self._pulled = pulled
        return self._stream.set_point

    def _look(self) -> Readiness:
        """Readiness by what is known at this moment: states age without anybody doing anything."""
        age = None if self._seen_at is None else self._clock() - self._seen_at
        self._readiness.update(self._report._replace(age=age))
        return self._readiness

    def _begin(self, command: _Command) -> None:
        """Have the ticks carry out a command. Raises ArmNotReadyError, or ArmStoppedError where a person is needed."""
        condition = self._look().condition
        if condition in _FOR_PERSONS:
            raise ArmStoppedError(self._readiness.why_not_ready)
        if condition is not Condition.READY:
            raise ArmNotReadyError(self._readiness.why_not_ready)
        self._require_place(self._measured())
        self._command = command

    def _require_place(self, pose: CameraPose) -> None:
        """Raise ArmNotReadyError for a camera too far off the plane, or the workspace, that it is to move in."""
        franka = self._config.franka
        if abs(pose.height) > franka.max_height_error:
            side = "above" if pose.height > 0.0 else "below"
            raise ArmNotReadyError(
                f"the camera is {abs(pose.height):.3f} m {side} its height over the table (franka/max_height_error): "
                "guide it there by hand, or see to franka/table_height, camera/distance and the camera's mount"
            )
        if pose.tilt_angle > franka.max_tilt:
            raise ArmNotReadyError(
                f"the camera looks {pose.tilt_angle:.2f} rad away from straight down (franka/max_tilt): guide it there "
                "by hand, or see to franka/camera_rotation"
            )
        reach = (franka.max_outside, franka.max_outside, franka.max_turn_outside)
        for name, at, low, high, most in zip(
            STATE_NAMES, pose.planar, self._workspace.lower, self._workspace.upper, reach
        ):
            beyond = max(low - at, at - high)
            if beyond > most:
                raise ArmNotReadyError(
                    f"the camera is {beyond:.3f} outside of workspace/{name} (m or rad; franka/max_outside, "
                    "franka/max_turn_outside): guide it there by hand, or see to the camera's mount"
                )

    def _wait(self, command: _Command, stop: StopSignal, until: float) -> None:
        """Let time pass until the next tick or state. Raises what has ended the command."""
        if stop.is_set():
            self._command = _Retreat()
            raise ArmStoppedError(f"the command was broken off: the arm was stopped by {stop.by}")
        if command.why_broken_off:
            why = f"the command was broken off: {command.why_broken_off}"
            if command.for_person:
                raise ArmStoppedError(why)
            raise ArmFailedError(why)
        if self._clock() > self._ticked_at + _LATEST_TICK:
            self._command = _Command()
            raise ArmFailedError(
                f"no set-point was sent for {_LATEST_TICK:g} s: the computer is overloaded, see /diagnostics"
            )
        self._pause(min(_LOOK, until - self._clock()))

    def _wait_for_rest(self) -> None:
        ends_at = self._clock() + _STOPPING
        while not self._is_at_rest():
            if self._clock() >= ends_at:
                raise ArmFailedError(self._why_not_at_rest())
            if self._readiness.condition in (Condition.AWAITED, Condition.SILENT, Condition.UNUSABLE):
                raise ArmFailedError(
                    "no set-point is sent any more, but whether the arm stands still is not known: "
                    f"{self._readiness.why_not_ready}"
                )
            self._pause(min(_LOOK, ends_at - self._clock()))

    def _pause(self, seconds: float) -> None:
        self._changed.wait(max(seconds, 1e-3))

    def _break_off(self, why: str, for_person: bool = False) -> None:
        """End the command under way, if there is any, with what its giver is told."""
        command = self._command
        if not command.why_broken_off:
            command.why_broken_off, command.for_person = why, for_person
        if not isinstance(command, _Retreat):
            self._command = _Command()

    def _measured(self) -> CameraPose:
        if self._track.pose is None:
            raise ArmNotReadyError(self._readiness.why_not_ready)
        return self._track.pose

    def _reached(self, limited: bool) -> Reached:
        return Reached(self._stamp, self._measured().planar, self._track.velocity, limited)

    def _has_arrived(self, target: Sequence[float]) -> bool:
        franka = self._config.franka
        set_point = self._stream.set_point
        if set_point is None or not self._is_at_rest():
            return False
        distance, turn = _distance(self._measured().planar, target)
        near = distance <= franka.tolerance and turn <= franka.turn_tolerance
        left, turn_left = _distance(set_point.planar, target)
        return near and left <= _LEFT and turn_left <= _TURN_LEFT

    def _why_not_reached(self, target: Sequence[float], allowed: float) -> str:
        distance, turn = _distance(self._measured().planar, target)
        lead, turn_lead = self._stream.lead(self._measured())
        return (
            f"pose {[round(value, 3) for value in target]} was not reached in {allowed:.1f} s: the arm is "
            f"{distance:.3f} m and {turn:.2f} rad away, its set-point {lead:.3f} m and {turn_lead:.2f} rad ahead: "
            "something is in its way; else its joints stick: raise franka/stiffness, franka/turn_stiffness, or "
            "franka/tolerance, franka/turn_tolerance"
        )

    def _why_not_at_rest(self) -> str:
        if not self._track.tells_motion:
            return (
                f"it cannot be told that the arm came to rest within {_STOPPING:g} s: its pose jumps from state to "
                "state; press the user stop"
            )
        return (
            f"the arm did not come to rest within {_STOPPING:g} s: it moves at "
            f"{[round(speed, 3) for speed in self._track.velocity]} (m/s, m/s, rad/s); press the user stop"
        )


def _distance(one: Sequence[float], other: Sequence[float]) -> Tuple[float, float]:
    """Distance in the plane, m, and turn the short way, rad."""
    return math.hypot(one[0] - other[0], one[1] - other[1]), abs(math.remainder(one[2] - other[2], 2.0 * math.pi))
