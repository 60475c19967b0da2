"""Whether the robot may be moved and when it may be recovered automatically: pure logic over its reports."""

from __future__ import annotations

import math
from typing import Callable, Optional, Tuple

from embodied_active_learning.config import FrankaConfig
from embodied_active_learning.franka.report import CONTROLLER, Condition, Report, RobotMode

FIRST_PAUSE = 1.0
"""Seconds before the first recovery; doubled with each consecutive one ..."""
MAX_PAUSE = 16.0
"""... up to this."""
RESET_AFTER = 20.0
"""Seconds of readiness after which earlier reflexes no longer count."""
GRACE = 1.0
"""Seconds that the control loop may take to start after its controller was started."""
TICK_TIMEOUT = 0.5
"""Seconds without a tick after which a command is given up."""
CONTROL_TIMEOUT = 3.0
"""Seconds after which the list of controllers and of publishers of set-points is outdated."""


class Readiness:
    """State machine over the robot's reports: its condition, and whether to prepare or recover the robot now.

    Reflexes are recovered from automatically up to franka/recoveries times in a row, with growing pauses. The robot is
    held until `release` after a user stop, after guiding by hand, once the recoveries are used up, if it was in a
    reflex before it was ever ready, and if another controller or node may have moved it into the reflex: a person has
    to confirm that it may move.
    """

    def __init__(self, config: FrankaConfig, clock: Callable[[], float]) -> None:
        self._config = config
        self._clock = clock
        self._report = Report()
        self._condition = Condition.NO_STATE
        # Why a person has to release the robot; forget_reflexes() ends only the second.
        self._manual_hold = self._reflex_hold = ""
        self._prepared = False
        self._preparation_error = ""
        self._retries_preparation = False
        self._recovering = False
        self._was_ready = False
        self._ready_since: Optional[float] = None
        self._uncontrolled_since: Optional[float] = None
        self._reflex_since: Optional[float] = None
        self._recovery_error = ""
        self._recovered_at = -math.inf
        self._consecutive_recoveries = 0
        self.recoveries = 0
        self.recovery_service = "/arm/recover"  # for messages; differs in a namespace

    @property
    def report(self) -> Report:
        """The report of the last update."""
        return self._report

    @property
    def condition(self) -> Condition:
        """The condition at the last update."""
        return self._condition

    @property
    def is_ready(self) -> bool:
        """Whether set-points may be sent."""
        return self._condition is Condition.READY

    @property
    def consecutive_recoveries(self) -> int:
        """Recoveries since the robot was last ready for RESET_AFTER."""
        return self._consecutive_recoveries

    @property
    def is_in_motion(self) -> bool:
        """Whether a controller moves or holds the robot."""
        return self._report.mode == RobotMode.MOVE

    @property
    def has_error(self) -> bool:
        """Whether the robot reports a reflex or an error."""
        return self._report.mode == RobotMode.REFLEX or bool(self._report.errors)

    @property
    def needs_preparation(self) -> bool:
        """Whether collision behaviour, load and stiffness have to be set and the controller started, and may be."""
        may_prepare = self._retries_preparation or not self._preparation_error
        return self._condition is Condition.UNPREPARED and may_prepare

    @property
    def needs_recovery(self) -> bool:
        """Whether it is time for an automatic recovery from a reflex."""
        if self._condition is not Condition.REFLEX or self._reflex_since is None:
            return False
        return self._clock() >= self._reflex_since + self.pause

    @property
    def pause(self) -> float:
        """Seconds between a reflex and the recovery from it."""
        return min(FIRST_PAUSE * 2.0**self._consecutive_recoveries, MAX_PAUSE)

    @property
    def held_for(self) -> str:
        """Why the robot is held until `release`; empty if it is not."""
        return self._manual_hold or self._reflex_hold

    @property
    def preparation_error(self) -> str:
        """Why the last preparation failed; empty if it did not."""
        return self._preparation_error

    @property
    def recovery_error(self) -> str:
        """Why the last recovery failed; empty if it did not."""
        return self._recovery_error

    def update(self, report: Report) -> Condition:
        """Evaluate a report; return the robot's condition now."""
        self._report = report
        now = self._clock()
        self._hold_after_manual_stop(report)
        self._check_preparation(report)
        self._condition = self._evaluate(report, now)
        if self._condition is not Condition.REFLEX:
            self._reflex_since = None
        elif self._reflex_since is None:
            self._reflex_since = now
        self._count_ready_time(now)
        return self._condition

    def set_prepared(self) -> None:
        """Record that the robot was prepared: settings made, controller started."""
        self._prepared, self._preparation_error = True, ""
        self._uncontrolled_since = None

    def set_unprepared(self, error: str, retry: bool = False) -> None:
        """Record that the preparation failed; it is retried after `release`, or automatically."""
        self._prepared, self._preparation_error, self._retries_preparation = False, error, retry

    def begin_recovery(self) -> None:
        """Record that a recovery has started."""
        self._recovering = True

    def end_recovery(self, error: str = "") -> None:
        """Record that a recovery has ended, successfully or with an error."""
        self._recovering, self._recovery_error = False, error
        self._recovered_at = -math.inf if error else self._clock()
        self._consecutive_recoveries += 1
        self.recoveries += 1
        self._reflex_since = self._uncontrolled_since = None

    def release(self) -> None:
        """A person has confirmed that the robot may move: earlier stops, reflexes and failures no longer count."""
        self._manual_hold = self._preparation_error = ""
        self.forget_reflexes()

    def hold(self, reason: str) -> None:
        """Hold the robot until `release`; an empty reason changes nothing."""
        self._manual_hold = reason or self._manual_hold

    def forget_reflexes(self) -> None:
        """Recoveries that a person has requested do not count."""
        self._reflex_hold = self._recovery_error = ""
        self._consecutive_recoveries = 0
        self._was_ready = True

    def _hold_after_manual_stop(self, report: Report) -> None:
        if report.age is None:
            return
        if report.mode == RobotMode.USER_STOPPED:
            self._manual_hold = "the user stop was pressed and has been released"
        elif report.mode == RobotMode.GUIDING:
            self._manual_hold = "the robot was guided by hand"

    def _check_preparation(self, report: Report) -> None:
        """Record that another node has stopped our controller, or that franka_control may have lost the settings."""
        if not self._prepared:
            return
        if report.controllers is None:
            if self._is_stale(report):
                self.set_unprepared("franka_control does not respond: the robot is prepared again", retry=True)
        elif report.other_controllers or not report.is_controlled:
            self.set_unprepared(
                f"{CONTROLLER} was stopped by another node: call {self.recovery_service} to start it again"
            )

    def _is_stale(self, report: Report) -> bool:
        max_age = self._config.state_max_age
        return report.age is None or report.age > max_age or abs(report.delay) > max_age

    def _evaluate(self, report: Report, now: float) -> Condition:
        recovering = self._recovering or report.mode == RobotMode.AUTOMATIC_ERROR_RECOVERY
        found = _first(
            (Condition.NO_STATE, report.age is None),
            (Condition.STALE, self._is_stale(report)),
            (Condition.USER_STOPPED, report.mode == RobotMode.USER_STOPPED),
            (Condition.GUIDED, report.mode == RobotMode.GUIDING),
            (Condition.RECOVERING, recovering),
            (Condition.UNUSABLE, bool(report.problem)),
            (Condition.RECOVERY_REQUIRED, bool(self.held_for)),
        )
        if found is not None:
            return found
        if self.has_error:
            # Older states may still arrive after a recovery.
            return Condition.STARTING if now < self._recovered_at + GRACE else self._evaluate_reflex()
        condition = self._evaluate_control(report, now)
        is_silent = condition is Condition.READY and report.tick_age > TICK_TIMEOUT
        return Condition.NO_SET_POINTS if is_silent else condition

    def _evaluate_reflex(self) -> Condition:
        """Recover automatically if this is allowed, or else hold the robot."""
        errors = self._report.error_names
        if not self._was_ready:
            self._reflex_hold = f"the robot was in a reflex ({errors}) before this node moved it"
        elif self._report.others:  # a recovery would restart their motion
            self._reflex_hold = f"robot reflex ({errors}) while {', '.join(self._report.others)} moved it"
        elif self._consecutive_recoveries >= self._config.recoveries:
            last = f"; last recovery: {self._recovery_error}" if self._recovery_error else ""
            self._reflex_hold = (
                f"robot reflex ({errors}) after {self._consecutive_recoveries} consecutive recoveries "
                f"(franka/recoveries){last}"
            )
        else:
            return Condition.REFLEX
        return Condition.RECOVERY_REQUIRED

    def _evaluate_control(self, report: Report, now: float) -> Condition:
        found = _first(
            (Condition.NO_CONTROLLER_MANAGER, report.controllers is None),
            (Condition.OTHER_CONTROLLER, bool(report.other_controllers)),
            (Condition.OTHER_PUBLISHER, bool(report.publishers)),
            (Condition.UNPREPARED, not self._prepared),
            # Last: while the robot is being prepared, its controllers are not listed.
            (Condition.OUTDATED_CONTROL, report.control_age > CONTROL_TIMEOUT),
        )
        if found is not None:
            self._uncontrolled_since = None
            return found
        if report.mode != RobotMode.MOVE:
            return self._evaluate_uncontrolled(now)
        self._uncontrolled_since = None
        return Condition.READY if report.has_subscriber else Condition.NO_SUBSCRIBER

    def _evaluate_uncontrolled(self, now: float) -> Condition:
        """The controller runs but the robot does not follow it: it is starting, or its control loop has ended."""
        if self._uncontrolled_since is None:
            self._uncontrolled_since = now
        if now - self._uncontrolled_since < GRACE:
            return Condition.STARTING
        return self._evaluate_reflex()

    def _count_ready_time(self, now: float) -> None:
        if self._condition is not Condition.READY:
            self._ready_since = None
            return
        self._was_ready = True
        self._recovered_at = -math.inf
        if self._ready_since is None:
            self._ready_since = now
        elif now - self._ready_since >= RESET_AFTER:
            self._consecutive_recoveries, self._recovery_error = 0, ""


def _first(*conditions: Tuple[Condition, bool]) -> Optional[Condition]:
    """The first condition that holds."""
    return next((condition for condition, holds in conditions if holds), None)
