"""A commander's lease on the arm."""

import pytest

from embodied_active_learning.errors import NoResponseError
from embodied_active_learning.ros.arm.lease import Lease

LONG = 1000.0


def test_lease_is_held_from_first_command_until_end():
    lease = Lease(LONG, lambda: True)
    assert not lease.is_held
    lease.renew()
    assert lease.is_held
    lease.end()
    assert not lease.is_held


def test_no_heartbeat_without_lease():
    lease = Lease(LONG, lambda: pytest.fail("heartbeat sent"))
    lease.extend()
    lease.renew()
    lease.end()
    lease.extend()


@pytest.mark.parametrize("granted", [True, False])
def test_arm_grants_or_denies_extension(granted):
    lease = Lease(LONG, lambda: granted)
    lease.renew()
    lease.extend()
    assert lease.is_held == granted


def test_missing_response_keeps_lease():
    def heartbeat():
        raise NoResponseError("gone")

    lease = Lease(LONG, heartbeat)
    lease.renew()
    lease.extend()
    assert lease.is_held


@pytest.mark.parametrize(("act", "granted", "held"), [("end", True, False), ("renew", False, True)])
def test_event_during_heartbeat_overrides_response(act, granted, held):
    def heartbeat():
        getattr(lease, act)()
        return granted

    lease = Lease(LONG, heartbeat)
    lease.renew()
    lease.extend()
    assert lease.is_held == held
