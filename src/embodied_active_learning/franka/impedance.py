"""Steady-state behaviour of cartesian_impedance_example_controller: how far the arm trails its set-point.

The controller filters the set-point with a time constant of 0.2 s. Its force is stiffness times distance, its torque
stiffness times the vector part of the error quaternion, sin(angle / 2), and its damping 2 sqrt(stiffness) for both.
"""

from __future__ import annotations

import math
from typing import List, NamedTuple

from embodied_active_learning.config import Config
from embodied_active_learning.motion_limits import PLANNED_BRAKING

FILTER_TIME = 0.2
"""Time constant of the controller's set-point filter, s."""
_STATE_PERIOD = 1.0 / 30.0
"""Age of the robot's newest state just before the next arrives, s."""


class LinearAngular(NamedTuple):
    """A linear quantity [m] and a rotational one [rad]."""

    linear: float
    angular: float


def lag(speed: float, stiffness: float) -> float:
    """Return the distance [m] by which the arm trails at a speed [m/s] and a stiffness [N/m]."""
    return speed * (FILTER_TIME + 2.0 / math.sqrt(stiffness))


def turn_lag(rate: float, stiffness: float) -> float:
    """Return the angle [rad] by which the arm trails at a turn rate [rad/s] and a stiffness [Nm/rad]."""
    return rate * FILTER_TIME + 2.0 * math.asin(min(1.0, 2.0 * rate / math.sqrt(stiffness)))


def required_leads(config: Config) -> LinearAngular:
    """Return the leads of the set-point [m], [rad] that the top speeds need: lag, braking distance and state age."""
    arm, franka = config.arm, config.franka
    linear = lag(arm.max_speed, franka.stiffness) + _reserve(arm.max_speed, arm.max_acceleration)
    angular = turn_lag(arm.max_turn_rate, franka.turn_stiffness)
    return LinearAngular(linear, angular + _reserve(arm.max_turn_rate, arm.max_turn_acceleration))


def lead_warnings(config: Config) -> List[str]:
    """Return a warning for each top speed that the arm cannot reach, because the set-point would lead too far."""
    required, franka = required_leads(config), config.franka
    warnings = []
    if required.linear > franka.max_lead:
        warnings.append(
            f"arm/max_speed cannot be reached: it needs a lead of {required.linear:.3f} m (franka/max_lead "
            f"{franka.max_lead:g}); lower arm/max_speed or raise franka/stiffness"
        )
    if required.angular > franka.max_turn_lead:
        warnings.append(
            f"arm/max_turn_rate cannot be reached: it needs a lead of {required.angular:.2f} rad (franka/max_turn_lead "
            f"{franka.max_turn_lead:g}); lower arm/max_turn_rate or raise franka/turn_stiffness"
        )
    return warnings


def _reserve(speed: float, acceleration: float) -> float:
    """Braking distance plus the motion until the next state."""
    return speed**2 / (2.0 * PLANNED_BRAKING * acceleration) + speed * _STATE_PERIOD
