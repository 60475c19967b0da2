"""Driver of a real arm by set-points: carries out commands as a stream of set-points, one per tick, without ROS.

Three kinds of threads meet here: one calls `tick`, one `update_state`, and those that command the arm wait. On any
failure no set-point is sent any more: the controller then holds the last one, which is within franka/max_lead of the
arm along each axis.
"""

from __future__ import annotations

import math
import threading
import time
from contextlib import contextmanager
from typing import Any, Callable, Dict, Iterator, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from embodied_active_learning.arm_requests import StopSignal, checked_duration, checked_pose, checked_velocity
from embodied_active_learning.config import Config, FrankaConfig
from embodied_active_learning.errors import ArmFailedError, ArmNotReadyError, ArmStoppedError, ObservationError
from embodied_active_learning.franka.explanation import why_not_ready
from embodied_active_learning.franka.motions import Brake, GoTo, Move, Retreat, SetPointMotion
from embodied_active_learning.franka.mount import CameraMount, CameraPose
from embodied_active_learning.franka.readiness import TICK_TIMEOUT, Readiness
from embodied_active_learning.franka.report import Condition, Report
from embodied_active_learning.franka.set_points import SetPointStream, Tracking
from embodied_active_learning.franka.start_check import require_startable
from embodied_active_learning.franka.state_history import StateHistory

AT_REST = (0.005, 0.005, 0.03)
"""m/s, m/s, rad/s: measured speeds up to these count as rest."""
_SETTLING_TIME = 4.0  # s that an impedance controller may take to draw the arm to its last set-point
_AT_TARGET, _TURN_AT_TARGET = 1e-4, 1e-3  # m, rad: a set-point this close to its target has arrived
_STOP_TIMEOUT = 3.0  # s within which a braking arm has to come to rest; less than a node has to shut down
_MAX_WAIT = 0.05  # s between two checks of a waiting command
_NEEDS_PERSON = (Condition.USER_STOPPED, Condition.GUIDED, Condition.RECOVERY_REQUIRED)
_UNKNOWN_MOTION = (Condition.NO_STATE, Condition.STALE, Condition.UNUSABLE, Condition.NO_SET_POINTS)


class Reached(NamedTuple):
    """The measured state at the end of a command."""

    stamp: float  # s, the robot's
    pose: Tuple[float, ...]  # (3,) m, m, rad
    velocity: Tuple[float, ...]  # (3,) m/s, m/s, rad/s
    limited: bool


class SetPointDriver:
    """Moves the arm for one command at a time, while other threads call update_state and tick."""

    def __init__(
        self,
        config: Config,
        clock: Callable[[], float] = time.monotonic,
        readiness: Optional[Readiness] = None,
        explain: Callable[[Readiness, FrankaConfig], str] = why_not_ready,
        stopping: Callable[[], SetPointMotion] = Retreat,
    ) -> None:
        """Create the driver. The last three arguments differ for another interface than franka_ros.

        Args:
            clock: returns the time [s].
            readiness: whether the robot is ready; None creates one for franka_ros.
            explain: returns why the robot is not ready.
            stopping: creates the motion that brings the arm to rest.
        """
        self._config = config
        self._clock = clock
        self._mount = CameraMount.from_config(config)
        self._history = StateHistory(config)
        self._stream = SetPointStream(config)
        self._changed = threading.Condition()
        self._readiness = readiness or Readiness(config.franka, clock)
        self._explain = explain
        self._stopping = stopping
        self._report = Report()
        self._received_at: Optional[float] = None
        self._stamp = 0.0
        self._jump = ""
        self._motion: SetPointMotion = Brake()
        self._ticked_at = self._controlled_at = clock()
        self._displaced = False
        self.jumps = 0
        self.displacements = 0

    @contextmanager
    def readiness(self) -> Iterator[Readiness]:
        """Yield the robot's readiness, evaluated now; in the block no other thread reads or changes it."""
        with self._changed:
            yield self._update_readiness()
            self._changed.notify_all()

    def update_state(
        self,
        stamp: float,
        delay: float,
        end_effector: Sequence[float],
        mode: int,
        errors: Optional[Sequence[str]] = None,
        last_errors: Sequence[str] = (),
    ) -> Optional[Reached]:
        """Process a state of the robot.

        Args:
            stamp: Of the state, s.
            delay: Of the stamp behind this computer's clock at arrival, s.
            end_effector: O_T_EE, (16,) column by column.
            mode: franka_msgs/FrankaState.robot_mode.
            errors: Names of the present errors; None leaves those of `update_control`.
            last_errors: Names of the errors that ended the last motion.

        Returns:
            The camera's measured state; None if the state is not new or unusable.
        """
        with self._changed:
            if not self._history.is_new(stamp):
                return None
            self._received_at = self._clock()
            problem = ""
            try:
                pose = self._mount.camera_pose(end_effector)
            except ObservationError as error:
                problem = str(error)
            else:
                self._add_pose(stamp, pose)
            self._report = self._report._replace(
                problem=problem,
                mode=mode,
                errors=self._report.errors if errors is None else tuple(errors),
                last_errors=tuple(last_errors),
                delay=delay,
            )
            self._stamp = stamp
            self._changed.notify_all()
            return None if problem else self._reached(False)

    def update_control(self, **fields: Any) -> None:
        """Process what is known of controllers, publishers and subscribers of set-points: fields of Report."""
        with self._changed:
            self._controlled_at = self._clock()
            self._report = self._report._replace(**fields)
            self._update_readiness()
            self._changed.notify_all()

    def tick(self) -> Optional[CameraPose]:
        """Advance the motion by the wall time since the last tick; return the set-point to send, if any."""
        with self._changed:
            now = self._clock()
            period, self._ticked_at = now - self._ticked_at, now
            try:
                return self._next_set_point(period)
            finally:
                self._changed.notify_all()

    def tracking(self) -> Optional[Tracking]:
        """Return the newest set-point and the pose that follows it; None while no set-point may be sent."""
        with self._changed:
            set_point, measured = self._stream.set_point, self._history.pose
            if set_point is None or measured is None:
                return None
            return Tracking(set_point, self._stream.velocity, measured)

    def move(self, velocity: Sequence[float], duration: float, stop: StopSignal) -> Reached:
        """Hold velocity (3,) [m/s, m/s, rad/s] for a duration [s of wall time] within the limits -> the state then.

        The arm keeps the velocity for franka/coast longer, so that the next move joins without a stop, and then brakes.

        Raises:
            CommandError: The request is invalid.
            ArmNotReadyError, ArmStoppedError: The robot accepts no command.
            ArmFailedError, ArmStoppedError: The motion was aborted.
        """
        requested = checked_velocity(velocity)
        duration = checked_duration(duration, self._config.arm.max_duration)
        with self._changed:
            ends_at = self._clock() + duration
            motion = Move(requested, ends_at + self._config.franka.coast, self._clock)
            self._begin(motion)
            while self._clock() < ends_at:
                self._wait(motion, stop, ends_at)
            limits = self._stream.limits
            limited = motion.limited or limits.differ(self._stream.velocity, limits.clamp_speed(requested))
            return self._reached(limited)

    def go_to(self, pose: Sequence[float], stop: StopSignal) -> Reached:
        """Move straight to a planar pose (3,) [m, m, rad] within the limits and stop there; return the state then.

        Raises:
            CommandError: The pose is outside the workspace.
            ArmFailedError: The arm did not reach it in time; see also `move`.
        """
        limits = self._stream.limits
        target = np.clip(checked_pose(pose, self._config.workspace.box()), limits.lower, limits.upper).tolist()
        with self._changed:
            motion = GoTo(target)
            self._begin(motion)
            here = self._measured().planar
            braking_time, travel_time = limits.braking_time(self._stream.velocity), limits.travel_time(here, target)
            timeout = _SETTLING_TIME + 2.0 * (braking_time + travel_time)
            deadline = self._clock() + timeout
            while not self._has_arrived(target):
                self._wait(motion, stop, deadline)
                if self._clock() >= deadline:
                    self._motion = Brake()
                    raise ArmFailedError(self._why_not_reached(target, timeout))
            self._motion = Brake()
            return self._reached(False)

    def stop(self) -> Reached:
        """Bring the arm to rest in any condition of the robot; return the state then.

        Raises ArmFailedError if the arm does not come to rest, or this cannot be verified.
        """
        with self._changed:
            motion = self._motion = self._stopping()
            try:
                self._wait_for_rest()
            finally:
                if self._motion is motion:  # a set-point that kept following the arm would let it drift anywhere
                    self._motion = Brake()
            return self._reached(False)

    def wait_until_ready(self, timeout: float) -> bool:
        """Wait up to a timeout [s] until the robot is ready; return whether it is."""
        with self._changed:
            deadline = self._clock() + timeout
            while not self._update_readiness().is_ready and self._clock() < deadline:
                self._sleep(_MAX_WAIT)
            return self._readiness.is_ready

    def why_not_ready(self) -> str:
        """Return what prevents the arm from moving; empty if nothing does."""
        with self._changed:
            self._update_readiness()
            return self._why_not_ready()

    def lead(self) -> Optional[Tuple[float, float]]:
        """Distance of the set-point from the measured pose, m and rad; None while none is sent."""
        with self._changed:
            measured = self._history.pose
            return None if measured is None or self._stream.set_point is None else self._stream.lead(measured)

    def values(self) -> Dict[str, object]:
        """Return the figures for diagnostics."""
        lead = self.lead()
        with self._changed:
            readiness, report = self._readiness, self._readiness.report
            return {
                "robot": readiness.condition.value,
                "mode": report.mode_name,
                "errors": report.error_names,
                "age of the newest state [s]": "-" if report.age is None else f"{report.age:.3f}",
                "running controllers": report.running_controllers,
                "recoveries": readiness.recoveries,
                "consecutive recoveries": readiness.consecutive_recoveries,
                "set-point lead [m, rad]": "-" if lead is None else f"{lead[0]:.3f}, {lead[1]:.2f}",
                "arm displacements beyond franka/max_lead": self.displacements,
                "pose jumps": self.jumps,
            }

    def is_at_rest(self) -> bool:
        """Whether set-point and arm are known to be at rest."""
        with self._changed:
            return self._is_at_rest()

    def _add_pose(self, stamp: float, pose: CameraPose) -> None:
        try:
            self._history.add(stamp, pose)
        except ObservationError as error:
            self._jump = str(error)
            self.jumps += 1

    def _is_at_rest(self) -> bool:
        is_known = self._update_readiness().condition not in _UNKNOWN_MOTION
        still = all(abs(speed) <= limit for speed, limit in zip(self._history.velocity, AT_REST))
        slow = all(abs(speed) <= limit for speed, limit in zip(self._stream.velocity, AT_REST))
        return is_known and self._history.is_velocity_known and still and slow

    def _next_set_point(self, period: float) -> Optional[CameraPose]:
        measured = self._history.pose
        if not self._update_readiness().is_ready or measured is None:
            self._stream.end()
            self._abort(self._why_not_ready(), self._readiness.condition in _NEEDS_PERSON)
            self._jump = ""
            return None
        if self._jump:
            self._stream.end()
            self._abort(self._jump)
            self._jump = ""
        if self._stream.set_point is None:
            self._stream.begin(measured)
        elif period > 0.0:
            displaced = self._motion.step(self._stream, measured, period).displaced
            self.displacements += displaced and not self._displaced
            self._displaced = displaced
        return self._stream.set_point

    def _update_readiness(self) -> Readiness:
        """Evaluate the readiness now: states age without any event."""
        now = self._clock()
        age = None if self._received_at is None else now - self._received_at
        control_age, tick_age = now - self._controlled_at, now - self._ticked_at
        self._readiness.update(self._report._replace(age=age, control_age=control_age, tick_age=tick_age))
        return self._readiness

    def _why_not_ready(self) -> str:
        return self._explain(self._readiness, self._config.franka)

    def _begin(self, motion: SetPointMotion) -> None:
        """Start a motion. Raises ArmNotReadyError, or ArmStoppedError if a person is needed."""
        condition = self._update_readiness().condition
        if condition in _NEEDS_PERSON:
            raise ArmStoppedError(self._why_not_ready())
        if condition is not Condition.READY:
            raise ArmNotReadyError(self._why_not_ready())
        require_startable(self._measured(), self._config)
        self._motion = motion

    def _wait(self, motion: SetPointMotion, stop: StopSignal, until: float) -> None:
        """Wait until the next tick or state. Raises the error that has ended the motion."""
        self._require_not_aborted(motion, stop)
        if self._clock() > self._ticked_at + TICK_TIMEOUT:
            self._motion = Brake()
            self._update_readiness()
            raise ArmFailedError(f"motion aborted: {self._why_not_ready()}")
        self._sleep(min(_MAX_WAIT, until - self._clock()))
        self._require_not_aborted(motion, stop)  # the caller may not wait again

    def _require_not_aborted(self, motion: SetPointMotion, stop: StopSignal) -> None:
        if stop.is_set():
            self._motion = self._stopping()
            raise ArmStoppedError(f"motion aborted: the arm was stopped by {stop.by}")
        if motion.aborted_by:
            message = f"motion aborted: {motion.aborted_by}"
            raise ArmStoppedError(message) if motion.needs_person else ArmFailedError(message)

    def _wait_for_rest(self) -> None:
        deadline = self._clock() + _STOP_TIMEOUT
        while not self._is_at_rest():
            if self._clock() >= deadline:
                raise ArmFailedError(self._why_not_at_rest())
            if self._readiness.condition in _UNKNOWN_MOTION:
                raise ArmFailedError(
                    f"set-points have stopped, but it is unknown whether the arm is at rest: {self._why_not_ready()}"
                )
            self._sleep(min(_MAX_WAIT, deadline - self._clock()))

    def _sleep(self, seconds: float) -> None:
        """Release the lock and wait for a change, at most so long."""
        self._changed.wait(max(seconds, 1e-3))

    def _abort(self, reason: str, needs_person: bool = False) -> None:
        """End the present motion with the reason that its command reports."""
        motion = self._motion
        if not motion.aborted_by:
            motion.aborted_by, motion.needs_person = reason, needs_person
        if not isinstance(motion, Retreat):
            self._motion = Brake()

    def _measured(self) -> CameraPose:
        if self._history.pose is None:
            raise ArmNotReadyError(self._why_not_ready())
        return self._history.pose

    def _reached(self, limited: bool) -> Reached:
        return Reached(self._stamp, self._measured().planar, self._history.velocity, limited)

    def _has_arrived(self, target: Sequence[float]) -> bool:
        franka = self._config.franka
        set_point = self._stream.set_point
        if set_point is None or not self._is_at_rest():
            return False
        distance, turn = _distance(self._measured().planar, target)
        left, turn_left = _distance(set_point.planar, target)
        is_near = distance <= franka.tolerance and turn <= franka.turn_tolerance
        return is_near and left <= _AT_TARGET and turn_left <= _TURN_AT_TARGET

    def _why_not_reached(self, target: Sequence[float], timeout: float) -> str:
        distance, turn = _distance(self._measured().planar, target)
        lead, turn_lead = self._stream.lead(self._measured())
        return (
            f"pose {[round(value, 3) for value in target]} not reached within {timeout:.1f} s: the arm is "
            f"{distance:.3f} m and {turn:.2f} rad away, its set-point {lead:.3f} m and {turn_lead:.2f} rad ahead; "
            "remove what blocks it, or if its joints stick raise franka/stiffness, franka/turn_stiffness, "
            "franka/tolerance or franka/turn_tolerance"
        )

    def _why_not_at_rest(self) -> str:
        if not self._history.is_velocity_known:
            return (
                f"not known to be at rest within {_STOP_TIMEOUT:g} s: the arm's pose jumps from state to state; press "
                "the user stop"
            )
        return (
            f"the arm did not come to rest within {_STOP_TIMEOUT:g} s: it moves at "
            f"{[round(speed, 3) for speed in self._history.velocity]} (m/s, m/s, rad/s); press the user stop"
        )


def _distance(one: Sequence[float], other: Sequence[float]) -> Tuple[float, float]:
    """Distance in the plane [m] and the smaller angle [rad]."""
    return math.hypot(one[0] - other[0], one[1] - other[1]), abs(math.remainder(one[2] - other[2], 2.0 * math.pi))
