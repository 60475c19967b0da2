"""Simulated arms, one per configuration: building one takes longer than most motions."""

import functools

from embodied_active_learning.simulation.arm import SimulatedArm


def arm_at_start(config):
    """Return the arm of a configuration in the state in which it was built. Do not close it."""
    arm, start = _built(config)
    arm.load_state_dict(start)
    return arm


@functools.lru_cache(maxsize=None)
def _built(config):
    arm = SimulatedArm(config)
    return arm, arm.state_dict()
