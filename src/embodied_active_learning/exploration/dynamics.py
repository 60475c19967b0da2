"""Arm dynamics for planning: one double integrator per axis, limited to the workspace (Paper, Appendix, Control)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from embodied_active_learning.config import Config


@dataclass(frozen=True)
class Rollout:
    """Predicted motion of B plans over H steps, and where limits were active."""

    positions: np.ndarray  # (B, H, D), normalised, after each step
    velocities: np.ndarray  # (B, H, D), velocity units, after each step
    position_free: np.ndarray  # (B, H, D) bool: position not clamped at the border
    velocity_free: np.ndarray  # (B, H, D) bool: velocity not clamped at its limit

    def select(self, plan: int) -> Rollout:
        """Return one of the plans, with a leading axis of length 1."""
        one = slice(plan, plan + 1)
        return Rollout(self.positions[one], self.velocities[one], self.position_free[one], self.velocity_free[one])


@dataclass(frozen=True)
class DoubleIntegrator:
    """x' = gain * v, v' = u for each axis; integrated exactly with the control u constant over a step.

    With step dt: v+ = v + dt u, x+ = x + dt gain (v + v+) / 2. Positions are normalised. Velocities are in controller
    units, in which `velocity_limit` is the arm's top speed, so gain = (top speed / velocity limit) / workspace scale:
    0.8, 0.8, 1.2 by default. The authors use 0.8 for every axis, which matches only their simulated x and y.
    """

    step: float  # s
    gain: np.ndarray  # (D,) normalised units per second and velocity unit
    velocity_limit: np.ndarray  # (D,) velocity units
    speed_unit: np.ndarray  # (D,) m/s, m/s, rad/s per velocity unit

    @classmethod
    def from_config(cls, config: Config) -> DoubleIntegrator:
        """Return the dynamics of the configured arm, workspace and step duration."""
        limit = np.asarray(config.planner.velocity_limits)
        top_speed = np.array([config.arm.max_speed, config.arm.max_speed, config.arm.max_turn_rate])
        speed_unit = top_speed / limit
        return cls(config.exploration.step_duration, speed_unit / config.workspace.box().scale, limit, speed_unit)

    def to_si(self, velocity: np.ndarray) -> np.ndarray:
        """Convert velocity units (..., D) to m/s, m/s, rad/s."""
        return velocity * self.speed_unit

    def from_si(self, velocity: np.ndarray) -> np.ndarray:
        """Convert m/s, m/s, rad/s (..., D) to velocity units."""
        return np.asarray(velocity, dtype=np.float64) / self.speed_unit

    def rollout(self, position: np.ndarray, velocity: np.ndarray, controls: np.ndarray) -> Rollout:
        """Predict the motion of B plans.

        The velocity is clamped to its limit and the position to the border, where outward velocity becomes zero.

        Args:
            position: (D,) current state, normalised.
            velocity: (D,) current velocity, velocity units.
            controls: (B, H, D) velocity units per second.
        """
        limit, half_step = self.velocity_limit, 0.5 * self.step * self.gain
        positions, velocities, unclamped, desired = (np.empty(controls.shape) for _ in range(4))
        for t in range(controls.shape[1]):
            desired[:, t] = velocity + self.step * controls[:, t]
            reached = np.minimum(np.maximum(desired[:, t], -limit), limit)
            unclamped[:, t] = position + half_step * (velocity + reached)
            position = positions[:, t] = np.minimum(np.maximum(unclamped[:, t], -1.0), 1.0)
            outward = (position != unclamped[:, t]) & (reached * position > 0.0)
            velocity = velocities[:, t] = np.where(outward, 0.0, reached)
        return Rollout(positions, velocities, positions == unclamped, np.abs(desired) <= limit)

    def backpropagate(
        self, rollout: Rollout, position_gradient: np.ndarray, velocity_gradient: np.ndarray
    ) -> np.ndarray:
        """Return the gradient of a cost by the controls: the adjoint of `rollout`.

        Where no limit is active, backwards from a = b = 0 at the horizon:
            a_t = a_{t+1} + dJ/dx_t
            w_t = b_{t+1} + dJ/dv_t + dt gain a_t / 2
            b_t = w_t + dt gain a_t / 2
            dJ/du_t = dt w_t

        Args:
            rollout: the predicted motion.
            position_gradient: (B, H, D) partial derivatives by each predicted position.
            velocity_gradient: (B, H, D) partial derivatives by each predicted velocity.

        Returns:
            (B, H, D) total derivatives by each control.
        """
        half_step = 0.5 * self.step * self.gain
        stopped = ~rollout.position_free & (rollout.velocities == 0.0)
        adjoint_position = adjoint_velocity = np.zeros_like(position_gradient[:, 0])
        gradient = np.empty_like(position_gradient)
        for t in reversed(range(gradient.shape[1])):
            adjoint_position = (adjoint_position + position_gradient[:, t]) * rollout.position_free[:, t]
            at_velocity = (adjoint_velocity + velocity_gradient[:, t]) * ~stopped[:, t]
            at_desired = (at_velocity + half_step * adjoint_position) * rollout.velocity_free[:, t]
            gradient[:, t] = self.step * at_desired
            adjoint_velocity = at_desired + half_step * adjoint_position
        return gradient
