"""Retry policy of the arm client: what its timeout counts."""

import pytest

from embodied_active_learning.errors import ArmFailedError, ArmStoppedError
from embodied_active_learning.ros.arm import retry_policy
from embodied_active_learning.ros.arm.retry_policy import RetryPolicy


class Clock:
    """Wall time that the test advances."""

    now = 10.0

    def monotonic(self):
        return self.now


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(retry_policy, "time", clock)
    return clock


def test_long_command_does_not_use_up_the_timeout(clock):
    policy = RetryPolicy(retries=5, timeout=15.0)
    policy.begin_call()
    clock.now += 20.0  # of an accepted command
    assert policy.after(ArmFailedError("reflex")).pause > 0.0


def test_timeout_starts_with_first_failure_of_a_call(clock):
    policy = RetryPolicy(retries=5, timeout=15.0)
    policy.begin_call()
    policy.after(ArmStoppedError("stopped"))
    clock.now += 15.0
    with pytest.raises(ArmStoppedError):
        policy.after(ArmStoppedError("stopped"))
    policy.begin_call()
    policy.after(ArmStoppedError("stopped"))


def test_pause_doubles_up_to_maximum():
    policy = RetryPolicy(retries=6)
    policy.begin_call()
    assert [policy.after(ArmFailedError("reflex")).pause for _ in range(6)] == [0.5, 1.0, 2.0, 4.0, 8.0, 8.0]
