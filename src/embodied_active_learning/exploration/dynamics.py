"""The arm as a double integrator for each axis, held inside the workspace."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from embodied_active_learning.config import Config


@dataclass(frozen=True)
class Rollout:
    """Predicted motion of B plans over H steps, and which limits cut it."""

    positions: np.ndarray  # (B, H, D), normalised, after each step
    velocities: np.ndarray  # (B, H, D), velocity units, after each step
    position_free: np.ndarray  # (B, H, D) bool: the border did not stop the axis
    velocity_free: np.ndarray  # (B, H, D) bool: the velocity limit did not cut the control

    def select(self, plan: int) -> Rollout:
        """One of the plans, still with a leading axis of 1."""
        one = slice(plan, plan + 1)
        return Rollout(self.positions[one], self.velocities[one], self.position_free[one], self.velocity_free[one])


@dataclass(frozen=True)
class DoubleIntegrator:
    """position' = gain * velocity, velocity' = control, integrated exactly with the control held over each step.

    Positions are normalised. Velocities are in the controller's units, in which velocity_limit is the arm's top speed;
    so gain is (top speed / velocity limit) / workspace scale, per axis: 0.8, 0.8, 1.2 by default. The authors have 0.8
    for all, right only for their simulated x and y (docs/method.md, section 5).
    """

    step: float  # s
    gain: np.ndarray  # (D,) normalised units per second and velocity unit
    velocity_limit: np.ndarray  # (D,) velocity units
    speed_unit: np.ndarray  # (D,) m/s, m/s, rad/s per velocity unit

    @classmethod
    def from_config(cls, config: Config) -> DoubleIntegrator:
        """The model of the configured arm, workspace and step."""
        limit = np.asarray(config.planner.velocity_limits)
        top_speed = np.array([config.arm.max_speed, config.arm.max_speed, config.arm.max_turn_rate])
        speed_unit = top_speed / limit
        return cls(config.exploration.step_duration, speed_unit / config.workspace.box().scale, limit, speed_unit)

    def to_si(self, velocity: np.ndarray) -> np.ndarray:
        """Velocity units (..., D) -> m/s, m/s, rad/s."""
        return velocity * self.speed_unit

    def from_si(self, velocity: np.ndarray) -> np.ndarray:
        """m/s, m/s, rad/s (..., D) -> velocity units."""
        return np.asarray(velocity, dtype=np.float64) / self.speed_unit

    def rollout(self, position: np.ndarray, velocity: np.ndarray, controls: np.ndarray) -> Rollout:
        """Predict plans. position, velocity: (D,) now, controls: (B, H, D).

        Velocity stops at its limit; at the border position stops and outward velocity becomes zero.
        """
        limit, half_step = self.velocity_limit, 0.5 * self.step * self.gain
        positions, velocities, unbounded, wanted = (np.empty(controls.shape) for _ in range(4))
        for t in range(controls.shape[1]):
            wanted[:, t] = velocity + self.step * controls[:, t]
            reached = np.minimum(np.maximum(wanted[:, t], -limit), limit)
            unbounded[:, t] = position + half_step * (velocity + reached)
            position = positions[:, t] = np.minimum(np.maximum(unbounded[:, t], -1.0), 1.0)
            outward = (position != unbounded[:, t]) & (reached * position > 0.0)
            velocity = velocities[:, t] = np.where(outward, 0.0, reached)
        return Rollout(positions, velocities, positions == unbounded, np.abs(wanted) <= limit)

    def backpropagate(
        self, rollout: Rollout, position_gradient: np.ndarray, velocity_gradient: np.ndarray
    ) -> np.ndarray:
        """Gradients by predicted states -> gradient by controls, the adjoint of rollout. (B, H, D) each."""
        half_step = 0.5 * self.step * self.gain
        stopped = ~rollout.position_free & (rollout.velocities == 0.0)
        to_position = to_velocity = np.zeros_like(position_gradient[:, 0])
        gradient = np.empty_like(position_gradient)
        for t in reversed(range(gradient.shape[1])):
            at_position = (to_position + position_gradient[:, t]) * rollout.position_free[:, t]
            at_velocity = (to_velocity + velocity_gradient[:, t]) * ~stopped[:, t]
            wanted = (at_velocity + half_step * at_position) * rollout.velocity_free[:, t]
            gradient[:, t] = self.step * wanted
            to_position, to_velocity = at_position, wanted + half_step * at_position
        return gradient
