"""The simulated Panda: joints, frames and physics in a separate PyBullet client."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Dict, Mapping, Tuple

import numpy as np
import pybullet

from embodied_active_learning.simulation.panda import ARM_JOINTS, OPTICAL_FRAME, physics_urdf
from embodied_active_learning.state_dict import StateDict

Rotation = Tuple[Tuple[float, ...], ...]
"""(3, 3), row by row."""

# The Panda compensates gravity, and its servos follow a joint velocity within a millisecond: modelled without gravity
# and with motors that follow at once.
_MOTOR_EFFORT = 1000.0  # N m


class PandaBody:
    """Seven velocity-controlled joints and the camera's optical frame."""

    def __init__(self, physics_rate: int) -> None:
        """Load the robot; physics_rate in steps per second."""
        self._rate = physics_rate
        self._steps = 0
        self._client = pybullet.connect(pybullet.DIRECT)
        pybullet.setTimeStep(1.0 / physics_rate, physicsClientId=self._client)
        self._robot = self._load()
        infos = [
            pybullet.getJointInfo(self._robot, index, physicsClientId=self._client)
            for index in range(pybullet.getNumJoints(self._robot, physicsClientId=self._client))
        ]
        index_of = {info[1].decode(): info[0] for info in infos}
        self._arm = [index_of[name] for name in ARM_JOINTS]
        self._optical = next(info[0] for info in infos if info[12].decode() == OPTICAL_FRAME)
        self._rest = [0.0] * len(self._arm)
        for index in range(-1, len(infos)):
            pybullet.changeDynamics(
                self._robot, index, linearDamping=0.0, angularDamping=0.0, physicsClientId=self._client
            )

    def close(self) -> None:
        """Free the client; the body cannot be used afterwards."""
        pybullet.disconnect(physicsClientId=self._client)

    @property
    def time(self) -> float:
        """Simulated seconds: physics steps divided by their rate."""
        return self._steps / self._rate

    @property
    def period(self) -> float:
        """Seconds of one physics step."""
        return 1.0 / self._rate

    def state_dict(self) -> StateDict:
        """Return physics `steps` (1,), `joints` (7,) [rad] and `joint_velocities` (7,) [rad/s]."""
        states = pybullet.getJointStates(self._robot, self._arm, physicsClientId=self._client)
        return {
            "steps": np.array([self._steps], dtype=np.float64),
            "joints": np.array([state[0] for state in states]),
            "joint_velocities": np.array([state[1] for state in states]),
        }

    def load_state_dict(self, state: Mapping[str, np.ndarray]) -> None:
        """Set physics steps, joint positions and joint velocities. The values are not checked."""
        self._steps = int(state["steps"][0])
        self._reset(state["joints"], state["joint_velocities"])

    def joint_states(self) -> Dict[str, Tuple[float, float]]:
        """Return position [rad] and velocity [rad/s] of every joint by name."""
        states = pybullet.getJointStates(self._robot, self._arm, physicsClientId=self._client)
        return {name: (state[0], state[1]) for name, state in zip(ARM_JOINTS, states)}

    def joints(self) -> np.ndarray:
        """Return the joint positions (7,), rad."""
        states = pybullet.getJointStates(self._robot, self._arm, physicsClientId=self._client)
        return np.array([state[0] for state in states])

    def optical_frame(self) -> Tuple[Tuple[float, ...], Rotation, Tuple[float, ...]]:
        """Return position (3,) [m], orientation (3, 3) and twist (6,) [m/s, rad/s] of the optical frame."""
        state = pybullet.getLinkState(
            self._robot, self._optical, computeLinkVelocity=1, computeForwardKinematics=1, physicsClientId=self._client
        )
        rotation = pybullet.getMatrixFromQuaternion(state[5])
        return state[4], (rotation[:3], rotation[3:6], rotation[6:]), state[6] + state[7]

    def jacobian(self, joints: np.ndarray) -> np.ndarray:
        """Return the Jacobian (6, 7) of the optical frame at joint positions (7,)."""
        linear, angular = pybullet.calculateJacobian(
            self._robot,
            self._optical,
            (0.0, 0.0, 0.0),
            joints.tolist(),
            self._rest,
            self._rest,
            physicsClientId=self._client,
        )
        return np.array(linear + angular)

    def place(self, joints: np.ndarray) -> None:
        """Set the joint positions (7,), at rest, without simulating the motion."""
        self._reset(joints, np.zeros(len(joints)))

    def drive(self, joints: np.ndarray, joint_velocities: np.ndarray) -> None:
        """Advance physics by one step from joint positions (7,) [rad] at joint velocities (7,) [rad/s]."""
        # Bullet's iterative solver needs up to 20 ms to bring strongly coupled joints to new velocities: start with
        # them, so that the motors only have to hold them.
        self._reset(joints, joint_velocities)
        pybullet.setJointMotorControlArray(
            self._robot,
            self._arm,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=joint_velocities.tolist(),
            forces=[_MOTOR_EFFORT] * len(self._arm),
            physicsClientId=self._client,
        )
        pybullet.stepSimulation(physicsClientId=self._client)
        self._steps += 1

    def _reset(self, joints: np.ndarray, joint_velocities: np.ndarray) -> None:
        pybullet.resetJointStatesMultiDof(
            self._robot,
            self._arm,
            targetValues=joints[:, None].tolist(),
            targetVelocities=joint_velocities[:, None].tolist(),
            physicsClientId=self._client,
        )

    def _load(self) -> int:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "panda.urdf"
            path.write_text(physics_urdf(), encoding="utf-8")
            return pybullet.loadURDF(str(path), useFixedBase=True, physicsClientId=self._client)
