"""A commander's hold on the arm, by its own account."""

import pytest

from embodied_active_learning.errors import NoResponseError
from embodied_active_learning.ros.arm.lease import Lease

LONG = 1000.0


def test_nothing_is_held_before_the_first_command_nor_after_the_end():
    lease = Lease(LONG, lambda: True)
    assert not lease.is_held
    lease.renew()
    assert lease.is_held
    lease.end()
    assert not lease.is_held


def test_nothing_is_asked_for_while_nothing_is_held():
    lease = Lease(LONG, lambda: pytest.fail("asked"))
    lease.extend()
    lease.renew()
    lease.end()
    lease.extend()


@pytest.mark.parametrize("granted", [True, False])
def test_the_arm_decides_whether_it_is_still_held(granted):
    lease = Lease(LONG, lambda: granted)
    lease.renew()
    lease.extend()
    assert lease.is_held == granted


def test_an_arm_that_does_not_answer_takes_nothing_away():
    def keep():
        raise NoResponseError("gone")

    lease = Lease(LONG, keep)
    lease.renew()
    lease.extend()
    assert lease.is_held


@pytest.mark.parametrize(("act", "granted", "held"), [("end", True, False), ("renew", False, True)])
def test_what_happens_while_the_arm_is_asked_counts_more_than_its_answer(act, granted, held):
    def keep():
        getattr(lease, act)()
        return granted

    lease = Lease(LONG, keep)
    lease.renew()
    lease.extend()
    assert lease.is_held == held
