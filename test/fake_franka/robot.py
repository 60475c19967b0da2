"""The robot behind franka_control: modes, reflexes, user stop and recovery, in real time by a given clock."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass, field
from typing import Callable, Dict, List, Sequence, Set, Tuple

from fake_franka.impedance import (
    STEP,
    ImpedanceHand,
    Quaternion,
    Vector,
    inverse,
    length_of,
    multiply,
    rotation_vector,
)

OTHER, IDLE, MOVE, GUIDING, REFLEX, USER_STOPPED, RECOVERY = range(7)
MODE_NAMES = ("Other", "Idle", "Move", "Guiding", "Reflex", "User stopped", "Automatic error recovery")
MAX_SPEED = 1.7  # m/s
MAX_TURN_RATE = 2.5  # rad/s
STOCK_FORCE_LIMITS = (20.0, 20.0, 20.0, 25.0, 25.0, 25.0)  # N, Nm
_MAX_CATCH_UP = 10.0  # s of motion that are made up for after the process was suspended


class CommandError(Exception):
    """libfranka rejects a command or aborts a motion; the message is libfranka's."""


@dataclass
class Truth:
    """True motion of the hand since the last request."""

    max_speed: float = 0.0  # m/s
    max_turn_rate: float = 0.0  # rad/s
    max_acceleration: float = 0.0  # m/s^2, under the controller; without the robot's own stops
    max_outside: float = 0.0  # m beyond the workspace
    max_height_error: float = 0.0  # m
    travelled: float = 0.0  # m
    max_step: float = 0.0  # m between consecutive set-points
    set_points: int = 0
    reflexes: int = 0
    recoveries: int = 0
    refused_commands: List[str] = field(default_factory=list)


@dataclass(frozen=True)
class Behaviour:
    """Properties that differ between robots and versions of franka_ros."""

    friction: float = 0.0  # N, along each axis
    end_of_motion: float = 0.0  # s for which the robot is in mode Move after its controller was stopped
    largest_step: float = 0.1  # m between two set-points; a robot has no such limit of its own
    largest_turn: float = 0.6  # rad between two set-points
    recovers_own_errors_only: bool = False  # a recovery succeeds without effect otherwise, as from franka_ros 0.10.2


class FakeRobot:
    """A Panda and the control loop of franka_control. Thread-safe."""

    def __init__(
        self,
        clock: Callable[[], float],
        position: Vector,
        orientation: Quaternion,
        behaviour: Behaviour,
        outside: Callable[[Vector, Quaternion], Tuple[float, float]] = lambda _position, _orientation: (0.0, 0.0),
        log: Callable[[str], None] = lambda _text: None,
    ) -> None:
        """outside: returns how far a pose is outside the workspace and off its height, m."""
        self.lock = threading.RLock()
        self.hand = ImpedanceHand(position, orientation, behaviour.friction)
        self.force_limits: Sequence[float] = STOCK_FORCE_LIMITS
        self.errors: Set[str] = set()
        self.last_motion_errors: Set[str] = set()
        self.felt = (0.0,) * 6  # N, Nm: the force that tripped the present reflex
        self._clock = clock
        self._behaviour = behaviour
        self._outside = outside
        self._log = log
        self._time = clock()
        self._begun = self._time
        self._controlled = False  # a running controller moves the arm
        self._impedance = False  # this is the impedance controller
        self._has_error = False  # franka_control has aborted a motion: its loop waits for an error recovery
        self._moves_until = -math.inf
        self._user_stop = False
        self._recovering = False
        self._ignored_recovery = False
        self._failing_recoveries = 0
        self._truth = Truth()

    @property
    def mode(self) -> int:
        """robot_mode of franka_states."""
        with self.lock:
            if self._user_stop:
                return USER_STOPPED
            if self._recovering:
                return RECOVERY
            if self.errors:
                return REFLEX
            return MOVE if self.is_driven or self._time < self._moves_until else IDLE

    @property
    def is_driven(self) -> bool:
        """Whether franka_control's control loop is running."""
        return self._controlled and not self._has_error

    @property
    def time(self) -> float:
        """Seconds since the start."""
        return self._time - self._begun

    def advance(self) -> None:
        """Advance to the present time in steps of a millisecond."""
        with self.lock:
            now = self._clock()
            if now - self._time > _MAX_CATCH_UP:
                self._time = now - _MAX_CATCH_UP
            before = self.hand.position
            for _ in range(int((now - self._time) / STEP)):
                self._step()
            self._note(before)

    def take_set_point(self, position: Vector, orientation: Quaternion) -> None:
        """Process a message on equilibrium_pose."""
        with self.lock:
            self.advance()
            last_position, last_orientation = self.hand.set_point
            step = length_of([new - old for new, old in zip(position, last_position)])
            turn = length_of(rotation_vector(multiply(orientation, inverse(last_orientation))))
            self.hand.set_point = (position, orientation)
            if not self._impedance or not self.is_driven:
                return  # when it is started, the controller latches the present pose
            self._truth.set_points += 1
            self._truth.max_step = max(self._truth.max_step, step)
            if step > self._behaviour.largest_step or turn > self._behaviour.largest_turn:
                self._trip("cartesian_reflex")

    def change_controllers(self, moves_the_arm: bool, impedance: bool) -> None:
        """Process a change of the running controllers."""
        with self.lock:
            self.advance()
            if self.is_driven and not moves_the_arm:
                self._moves_until = self._time + self._behaviour.end_of_motion
            self._controlled, self._impedance = moves_the_arm, impedance
            if not self._has_error:
                self._start_motion()

    def reflex(self, error: str) -> None:
        """Trip a reflex with an error of franka_msgs/Errors."""
        with self.lock:
            self.advance()
            self._trip(error)

    def restart_control(self) -> None:
        """Crash and restart franka_control: the robot keeps its error, of which the new process knows nothing."""
        with self.lock:
            self.lose_contact()
            self._controlled = self._impedance = self._has_error = False

    def lose_contact(self) -> None:
        """Process that franka_control does not respond any more."""
        with self.lock:
            self.advance()
            if self.is_driven:
                self._trip("communication_constraints_violation")

    def set_user_stop(self, pressed: bool) -> None:
        """Press or release the user stop."""
        with self.lock:
            self.advance()
            was_driven = self.is_driven
            self._user_stop = pressed
            self.errors = set()  # the robot reports none while it is pressed, nor afterwards
            if pressed and was_driven:
                self._end_motion("libfranka: Move command aborted: User Stop pressed!", set())

    def command(self, name: str, apply: Callable[[], None]) -> None:
        """Apply a setter of libfranka, which is possible in mode Idle only. Raises CommandError."""
        with self.lock:
            self.advance()
            if self.mode != IDLE:
                error = self._rejected(name)
                self._truth.refused_commands.append(str(error))
                raise error
            apply()

    def fail_next_recovery(self) -> int:
        """Make one more recovery fail -> the number that will."""
        with self.lock:
            self._failing_recoveries += 1
            return self._failing_recoveries

    def begin_recovery(self) -> None:
        """Start an error recovery. Raises CommandError if it is not possible now."""
        with self.lock:
            self.advance()
            self._ignored_recovery = self._behaviour.recovers_own_errors_only and not self._has_error
            if self._ignored_recovery:
                return
            if self.mode not in (IDLE, REFLEX):
                raise self._rejected("Automatic Error Recovery")
            self._recovering = bool(self.errors)

    def end_recovery(self) -> None:
        """Finish a recovery and restart the running controllers. Raises CommandError if it failed."""
        with self.lock:
            self.advance()
            if self._ignored_recovery:
                return
            self._recovering = False
            if self._user_stop:
                raise CommandError("libfranka: Automatic Error Recovery command aborted: User Stop pressed!")
            if self._failing_recoveries > 0:
                self._failing_recoveries -= 1
                raise CommandError(
                    "libfranka: Automatic Error Recovery command rejected: manual error recovery required!"
                )
            self._truth.recoveries += 1
            self.errors = set()
            self.felt = (0.0,) * 6
            self._has_error = False
            self._start_motion()

    def take_truth(self) -> Dict[str, object]:
        """Return the fields of Truth since the last call, and reset them."""
        with self.lock:
            self.advance()
            truth, self._truth = self._truth, Truth()
            return vars(truth)

    def _start_motion(self) -> None:
        """Enter the control loop: the running controllers are started and latch the pose."""
        if not self._controlled:
            return
        if self.mode != MOVE:
            self._has_error = True
            self._log(str(self._rejected("Move")))
            return
        self.hand.latch()

    def _trip(self, error: str) -> None:
        self.felt = (*self.hand.force, *self.hand.torque)
        self._truth.reflexes += 1
        self.errors = {error}
        self._end_motion(f'libfranka: Move command aborted: motion aborted by reflex! ["{error}"]', {error})

    def _end_motion(self, message: str, errors: Set[str]) -> None:
        if self.is_driven:
            self.last_motion_errors = errors
            self._has_error = True
            self._log(message)

    def _rejected(self, command: str) -> CommandError:
        mode = MODE_NAMES[self.mode]
        return CommandError(
            f'libfranka: {command} command rejected: command not possible in the current mode ("{mode}")!'
        )

    def _step(self) -> None:
        self._time += STEP
        hand, truth = self.hand, self._truth
        if not (self._impedance and self.is_driven):
            hand.brake()
            return
        hand.advance()
        truth.max_acceleration = max(truth.max_acceleration, hand.acceleration)
        if any(abs(felt) > limit for felt, limit in zip((*hand.force, *hand.torque), self.force_limits)):
            self._trip("cartesian_reflex")
        elif hand.speed > MAX_SPEED or hand.turn_rate > MAX_TURN_RATE:
            self._trip("cartesian_velocity_violation")

    def _note(self, before: Sequence[float]) -> None:
        hand, truth = self.hand, self._truth
        truth.max_speed = max(truth.max_speed, hand.speed)
        truth.max_turn_rate = max(truth.max_turn_rate, hand.turn_rate)
        truth.travelled += length_of([now - then for now, then in zip(hand.position, before)])
        beyond, off_height = self._outside(hand.position, hand.orientation)
        truth.max_outside = max(truth.max_outside, beyond)
        truth.max_height_error = max(truth.max_height_error, off_height)
