"""Simulated arms, one per configuration: building one takes longer than most motions."""

import functools

import numpy as np

from embodied_active_learning.simulation.arm import SimulatedArm
from embodied_active_learning.simulation.panda import ARM_JOINTS
from embodied_active_learning.simulation.servo import JOINT_LIMITS


def arm_at_start(config):
    """Return the arm of a configuration in the state in which it was built. Do not close it."""
    arm, start = _built(config)
    arm.load_state_dict(start)
    return arm


@functools.lru_cache(maxsize=None)
def _built(config):
    arm = SimulatedArm(config)
    return arm, arm.state_dict()


def assert_upright(arm):
    """Check that the default height and the tilt of the camera are held, and that the joints are legal."""
    assert abs(arm.camera_height - 0.3) < 1e-3
    assert arm.tilt < 0.005
    joints = np.array([arm.joint_positions[name] for name in ARM_JOINTS])
    assert np.all(joints >= JOINT_LIMITS[:, 0])
    assert np.all(joints <= JOINT_LIMITS[:, 1])
