"""Recovery of a robot at a person's request: not at the same time as an automatic one, and held if it fails."""

from __future__ import annotations

import threading
from contextlib import contextmanager
from typing import Iterator

import rospy

from embodied_active_learning.errors import ArmNotReadyError
from embodied_active_learning.franka.set_point_driver import SetPointDriver
from embodied_active_learning.ros import names

LOCK_TIMEOUT = 5.0
"""Wall seconds that a preparation or recovery in progress may take to end."""


@contextmanager
def requested_recovery(driver: SetPointDriver, lock: threading.Lock) -> Iterator[None]:
    """Hold a supervisor's lock during the block, and hold the robot if the block fails.

    The person sees that it failed, and may approach: the robot must not become ready automatically later.

    Raises ArmNotReadyError if the lock is not free in time.
    """
    if not lock.acquire(timeout=LOCK_TIMEOUT):
        why = driver.why_not_ready()
        raise ArmNotReadyError(
            f"the robot is being prepared or recovered, or does not respond{f' ({why})' if why else ''}: call "
            f"{rospy.resolve_name(names.ARM_RECOVER)} again later"
        )
    try:
        yield
    except Exception as error:
        with driver.readiness() as readiness:
            readiness.hold(f"the requested recovery failed ({error})")
        raise
    finally:
        lock.release()
