"""Whether the robot may be moved, why not, and when it may recover by itself: pure logic over what it reports."""

from __future__ import annotations

import enum
import math
from typing import Callable, Mapping, NamedTuple, Optional, Sequence, Tuple

from embodied_active_learning.config import FrankaConfig

CONTROLLER = "cartesian_impedance_example_controller"
"""The controller of franka_example_controllers that draws the arm to our set-points."""
FIRST_PAUSE = 1.0
"""Seconds before the first recovery; doubled with each one more in a row ..."""
LONGEST_PAUSE = 16.0
"""... up to this."""
GOOD_STRETCH = 20.0
"""Seconds without a reflex after which those before no longer count."""
GRACE = 1.0
"""Seconds that the control loop may take to begin after its controller was started."""


class RobotMode(enum.IntEnum):
    """franka_msgs/FrankaState.robot_mode."""

    OTHER = 0
    IDLE = 1
    MOVE = 2
    GUIDING = 3
    REFLEX = 4
    USER_STOPPED = 5
    AUTOMATIC_ERROR_RECOVERY = 6


class Condition(enum.Enum):
    """What the robot is in; only a ready one is sent set-points."""

    AWAITED = "no state yet"
    SILENT = "silent"
    UNUSABLE = "unusable states"
    USER_STOPPED = "user stop"
    GUIDED = "guided by hand"
    HELD = "held for a person"
    RECOVERING = "recovering"
    REFLEX = "reflex"
    NO_CONTROLLER_MANAGER = "no controller_manager"
    OTHER_CONTROLLER = "another controller"
    RIVAL = "another node's set-points"
    UNPREPARED = "not prepared"
    STOPPED = "controller stopped"
    UNHEARD = "nobody hears set-points"
    STARTING = "starting"
    READY = "ready"


class Controller(NamedTuple):
    """A controller of controller_manager: its state, and whether it claims joints or the end effector to move them."""

    state: str  # initialized | running | stopped
    moves: bool

    @property
    def drives(self) -> bool:
        """Whether it moves the robot now."""
        return self.moves and self.state == "running"


class Report(NamedTuple):
    """What is known of the robot; ages in seconds of wall time."""

    age: Optional[float] = None  # since a state that is newer than those before has come
    delay: float = 0.0  # of the newest state's stamp behind the clock of this computer, when it came; either sign
    trouble: str = ""  # what makes the newest state unusable
    mode: int = RobotMode.OTHER
    errors: Tuple[str, ...] = ()  # names of those that are there now
    last_errors: Tuple[str, ...] = ()  # names of those that ended the last motion
    controllers: Optional[Mapping[str, Controller]] = None  # by name; None while controller_manager does not answer
    rivals: Sequence[str] = ()  # other nodes that publish set-points
    heard: bool = True  # whether anybody subscribes to our set-points


class Readiness:
    """Follows the robot's reports: whether it is ready, what it lacks in words, and whether to recover it now.

    Reflexes are recovered from franka/recoveries times in a row, with growing pauses. What a person has done to the
    robot, a person has to undo: after a user stop and after guiding by hand nothing moves until release is called, and
    so it is when recoveries are used up, and for a robot that was in a reflex before it ever was ready.
    """

    def __init__(self, config: FrankaConfig, clock: Callable[[], float]) -> None:
        self._config = config
        self._clock = clock
        self._report = Report()
        self._condition = Condition.AWAITED
        self._held_for = ""
        self._prepared = False
        self._unprepared = ""
        self._recovering = False
        self._was_ready = False
        self._ready_since: Optional[float] = None
        self._uncontrolled_since: Optional[float] = None
        self._reflex_since: Optional[float] = None
        self._refusal = ""
        self._recovered_at = -math.inf
        self._in_a_row = 0
        self.recoveries = 0

    @property
    def condition(self) -> Condition:
        """As of the last update."""
        return self._condition

    @property
    def is_ready(self) -> bool:
        """Whether set-points may be sent."""
        return self._condition is Condition.READY

    @property
    def recoveries_in_a_row(self) -> int:
        """Reflexes recovered from without a good stretch in between."""
        return self._in_a_row

    @property
    def is_in_motion(self) -> bool:
        """Whether the robot is controlled by somebody, moved or held."""
        return self._report.mode == RobotMode.MOVE

    @property
    def needs_preparation(self) -> bool:
        """Whether collision behaviour and load are still to be set and the controller to be started, and may be."""
        return self._condition is Condition.UNPREPARED and not self._unprepared

    @property
    def needs_recovery(self) -> bool:
        """Whether it is time to recover from a reflex without being asked."""
        if self._condition is not Condition.REFLEX or self._reflex_since is None:
            return False
        return self._clock() >= self._reflex_since + self.pause

    @property
    def pause(self) -> float:
        """Seconds between a reflex and the recovery from it."""
        return min(FIRST_PAUSE * 2.0**self._in_a_row, LONGEST_PAUSE)

    @property
    def errors_in_words(self) -> str:
        """The names of what is wrong now, else of what ended the last motion."""
        return ", ".join(self._report.errors or self._report.last_errors) or "no error is named"

    @property
    def mode_in_words(self) -> str:
        """The robot's mode."""
        known = {mode.value: mode.name.lower().replace("_", " ") for mode in RobotMode}
        return known.get(self._report.mode, f"unknown ({self._report.mode})")

    @property
    def age_in_words(self) -> str:
        """Seconds since a new state came; a dash where none did."""
        return "-" if self._report.age is None else f"{self._report.age:.3f}"

    @property
    def controllers_in_words(self) -> str:
        """Which controllers run."""
        controllers = self._report.controllers or {}
        return ", ".join(name for name, one in controllers.items() if one.state == "running") or "none known to run"

    @property
    def why_not_ready(self) -> str:
        """A sentence on what keeps the robot from being moved, and what to do about it."""
        condition, report = self._condition, self._report
        why = ""
        if condition is Condition.AWAITED:
            why = "no state of the robot has come yet: is franka_control running, and its state controller?"
        elif condition is Condition.SILENT:
            why = self._why_silent()
        elif condition is Condition.UNUSABLE:
            why = f"the robot's state cannot be used: {report.trouble}"
        elif condition is Condition.USER_STOPPED:
            why = "the user stop is pressed: release it, then call /arm/recover"
        elif condition is Condition.GUIDED:
            why = "the robot is guided by hand: let go of it, then call /arm/recover"
        elif condition is Condition.HELD:
            why = f"{self._held_for}: look at the robot, then call /arm/recover"
        elif condition is Condition.RECOVERING:
            why = "the robot is recovering from a reflex"
        elif condition is Condition.REFLEX:
            why = self._why_in_reflex()
        elif condition is not Condition.READY:
            why = self._why_not_controlled()
        return why

    def _why_silent(self) -> str:
        report = self._report
        if report.age is not None and report.age > self._config.state_max_age:
            return (
                f"no new state of the robot has come for {report.age:.2f} s (franka/state_max_age): look at "
                "franka_control, and at the cable between the computers"
            )
        return (
            f"the robot's states are {report.delay:.2f} s off this computer's clock when they come "
            "(franka/state_max_age): set the clocks of both computers by one source, or mend the network"
        )

    def _why_in_reflex(self) -> str:
        refused = f"; last time: {self._refusal}" if self._refusal else ""
        return (
            f"the robot is in a reflex ({self.errors_in_words}) and recovers by itself soon, for the "
            f"{self._in_a_row + 1}. time in a row{refused}"
        )

    def _why_not_controlled(self) -> str:
        condition, report = self._condition, self._report
        why = f"{CONTROLLER} runs, but the robot does not follow it yet"
        if condition is Condition.NO_CONTROLLER_MANAGER:
            why = "controller_manager has not answered: is franka_control running?"
        elif condition is Condition.OTHER_CONTROLLER:
            why = (
                f"{', '.join(self._others)} moves the robot: have its owner stop it (rosrun controller_manager "
                f"controller_manager stop {self._others[0]}), then call /arm/recover"
            )
        elif condition is Condition.RIVAL:
            why = (
                f"{', '.join(report.rivals)} sends set-points to {CONTROLLER} too: end that node (the example launch "
                "file of the controller starts one)"
            )
        elif condition is Condition.UNPREPARED:
            why = self._unprepared or f"{CONTROLLER} is not started yet"
        elif condition is Condition.STOPPED:
            why = f"{CONTROLLER} was stopped, not by this node: call /arm/recover to start it again"
        elif condition is Condition.UNHEARD:
            why = f"{CONTROLLER} does not listen to set-points: this needs franka_ros 0.8 or newer"
        return why

    def update(self, report: Report) -> Condition:
        """Take in a report -> what the robot is in now."""
        self._report = report
        now = self._clock()
        self._note_people(report)
        self._condition = self._of(report, now)
        if self._condition is not Condition.REFLEX:
            self._reflex_since = None
        elif self._reflex_since is None:
            self._reflex_since = now
        self._count_good_time(now)
        return self._condition

    def prepared(self) -> None:
        """Note that collision behaviour and load are set and the controller was started."""
        self._prepared, self._unprepared = True, ""

    def not_prepared(self, why: str) -> None:
        """Note that this failed, and why; it is tried again when somebody calls release."""
        self._prepared, self._unprepared = False, why

    def begin_recovery(self) -> None:
        """Note that a recovery has begun."""
        self._recovering = True

    def end_recovery(self, refusal: str = "") -> None:
        """Note how a recovery ended: with a refusal of the robot in words, or well."""
        self._recovering, self._refusal = False, refusal
        self._recovered_at = -math.inf if refusal else self._clock()
        self._in_a_row += 1
        self.recoveries += 1
        self._reflex_since = self._uncontrolled_since = None

    def release(self) -> None:
        """A person has looked at the robot and has it go on: nothing of before counts."""
        self._held_for = self._unprepared = self._refusal = ""
        self._in_a_row = 0
        self._was_ready = True

    @property
    def _others(self) -> Tuple[str, ...]:
        controllers = self._report.controllers or {}
        return tuple(name for name, one in controllers.items() if one.drives and name != CONTROLLER)

    def _note_people(self, report: Report) -> None:
        if report.age is None:
            return
        if report.mode == RobotMode.USER_STOPPED:
            self._held_for = "the user stop was pressed, and is released"
        elif report.mode == RobotMode.GUIDING:
            self._held_for = "the robot was guided by hand"

    def _of(self, report: Report, now: float) -> Condition:
        longest = self._config.state_max_age
        age = math.inf if report.age is None else report.age
        recovering = self._recovering or report.mode == RobotMode.AUTOMATIC_ERROR_RECOVERY
        found = _first(
            (Condition.AWAITED, report.age is None),
            (Condition.SILENT, age > longest or abs(report.delay) > longest),
            (Condition.USER_STOPPED, report.mode == RobotMode.USER_STOPPED),
            (Condition.GUIDED, report.mode == RobotMode.GUIDING),
            (Condition.RECOVERING, recovering),
            (Condition.UNUSABLE, bool(report.trouble)),
            (Condition.HELD, bool(self._held_for)),
        )
        if found is not None:
            return found
        if report.mode == RobotMode.REFLEX or report.errors:
            # States of before a recovery may still be under way when it has ended.
            return Condition.STARTING if now < self._recovered_at + GRACE else self._of_reflex()
        return self._of_control(report, now)

    def _of_reflex(self) -> Condition:
        if not self._was_ready:
            self._held_for = f"the robot was in a reflex ({self.errors_in_words}) before it was moved"
        elif self._in_a_row >= self._config.recoveries:
            refused = f"; last time: {self._refusal}" if self._refusal else ""
            self._held_for = (
                f"the robot is in a reflex ({self.errors_in_words}) again after {self._in_a_row} recoveries in a row "
                f"(franka/recoveries){refused}"
            )
        else:
            return Condition.REFLEX
        return Condition.HELD

    def _of_control(self, report: Report, now: float) -> Condition:
        controllers = report.controllers or {}
        ours = controllers.get(CONTROLLER)
        found = _first(
            (Condition.NO_CONTROLLER_MANAGER, report.controllers is None),
            (Condition.OTHER_CONTROLLER, bool(self._others)),
            (Condition.RIVAL, bool(report.rivals)),
            (Condition.UNPREPARED, not self._prepared),
            (Condition.STOPPED, ours is None or not ours.drives),
        )
        if found is not None:
            return found
        if report.mode != RobotMode.MOVE:
            return self._of_uncontrolled(now)
        self._uncontrolled_since = None
        return Condition.READY if report.heard else Condition.UNHEARD

    def _of_uncontrolled(self, now: float) -> Condition:
        """A controller that runs while the robot does not follow: it is about to, or its control loop has ended."""
        if self._uncontrolled_since is None:
            self._uncontrolled_since = now
        if now - self._uncontrolled_since < GRACE:
            return Condition.STARTING
        return self._of_reflex()

    def _count_good_time(self, now: float) -> None:
        if self._condition is not Condition.READY:
            self._ready_since = None
            return
        self._was_ready = True
        self._recovered_at = -math.inf
        if self._ready_since is None:
            self._ready_since = now
        elif now - self._ready_since >= GOOD_STRETCH:
            self._in_a_row, self._refusal = 0, ""


def _first(*conditions: Tuple[Condition, bool]) -> Optional[Condition]:
    """The first condition that holds."""
    return next((condition for condition, holds in conditions if holds), None)
