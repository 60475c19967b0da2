"""Retries, timeouts and pauses of the arm client, with an arm and a camera that fail on demand; no ROS master."""

import contextlib
import threading
from types import SimpleNamespace

import numpy as np
import pytest
import rospy

from embodied_active_learning.config import Config
from embodied_active_learning.errors import (
    ArmBusyError,
    ArmFailedError,
    ArmStoppedError,
    CommandError,
    NoResponseError,
    ObservationError,
)
from embodied_active_learning.exploration.commands import VelocityCommand
from embodied_active_learning.ros.arm import lease, retry_policy, retrying_arm
from embodied_active_learning.ros.arm.client import ArmClient
from embodied_active_learning.ros.conversions import image_message, state_message
from embodied_active_learning.ros.runtime.diagnostics import ERROR, WARN, Health
from threads import in_a_thread, wait_for

FORWARD = VelocityCommand(0.1, 0.0, 0.0, 0.2)
REACHED = state_message(rospy.Time(1), (0.5, 0.0, 0.0), (0.0, 0.0, 0.0))


class Arm:
    """Records its calls; the next ones fail with `failures`, in their order."""

    can_restore = False
    stop_if_commander = ArmClient.stop_if_commander

    def __init__(self):
        self.calls = []
        self.failures = []
        self.heartbeats = 0
        self._stop_lock = threading.Lock()
        self.responds = threading.Event()
        self.responds.set()

    def move(self, velocity, duration):
        return self._respond(("move", *velocity))

    def go_to(self, pose):
        return self._respond(("go_to", *pose))

    def stop(self):
        self._respond(("stop",))

    def heartbeat(self):
        self.heartbeats += 1
        return True

    def _respond(self, call):
        self.calls.append(call)
        assert self.responds.wait(10.0)
        if self.failures:
            raise self.failures.pop(0)
        return REACHED


class SimulatedArm(Arm):
    """Counts its commands as seconds; can be killed and restarted, and return to any time in `saved`."""

    can_restore = True

    def __init__(self, camera):
        super().__init__()
        self._camera = camera
        self._time = 0
        self.saved = range(100)
        self.has_commander = False
        self.is_dead = False
        self.emergency_stops = 0

    def move(self, velocity, duration):
        self._respond(("move", *velocity))
        return self._advance()

    def go_to(self, pose):
        self._respond(("go_to", *pose))
        return self._advance()

    def restore(self, stamp):
        self._respond(("restore", stamp.secs))
        if stamp.secs not in self.saved:
            raise CommandError("no saved arm state")
        return self._set_time(stamp.secs)

    def stop(self):
        self._respond(("stop",))
        self.emergency_stops += not self.has_commander
        self._advance()
        self.has_commander = False

    def heartbeat(self):
        return self.has_commander

    def restart(self):
        self.is_dead, self.has_commander, self._time = False, False, 0
        self._camera.receive_time(0)

    def brake(self):
        """Stop because the commander is silent."""
        self._advance()
        self.has_commander = False

    def _advance(self):
        return self._set_time(self._time + 1)

    def _set_time(self, time):
        self._time, self.has_commander = time, True
        self._camera.receive_time(time)
        return state_message(rospy.Time(time), (0.5, 0.0, 0.0), (0.0, 0.0, 0.0))

    def _respond(self, call):
        super()._respond(call)
        if self.is_dead:
            raise NoResponseError("no response")


class Camera:
    restarts = 0
    newest_state = None

    def __init__(self):
        self.failures = []
        self.stamps = []  # of the next images, if another than asked for

    def receive_time(self, time):
        stamp = rospy.Time(time)
        self.restarts += self.newest_state is not None and stamp < self.newest_state
        self.newest_state = stamp

    def take(self, after):
        if self.failures:
            raise self.failures.pop(0)
        return image_message(self.stamps.pop() if self.stamps else after, np.zeros((2, 2, 3), np.uint8)), REACHED


@pytest.fixture
def arm(monkeypatch):
    arm = Arm()
    monkeypatch.setattr(retrying_arm, "ArmClient", lambda: arm)
    return arm


@pytest.fixture
def camera(monkeypatch):
    camera = Camera()
    monkeypatch.setattr(retrying_arm, "PosedCamera", lambda config: camera)
    monkeypatch.setattr(retry_policy, "RETRY_PERIOD", 0.01)
    return camera


@pytest.fixture
def retrying(arm, camera):
    return retrying_arm.RetryingArm(Config())


def problem(retrying):
    """Return what diagnostics report; empty while commands succeed."""
    return retrying.health(Health()).message


@pytest.fixture
def paused(monkeypatch):
    """Set as soon as a command waits for the end of a pause."""
    paused, wait = threading.Event(), retrying_arm.wait_until

    def wait_until(*arguments):
        paused.set()
        wait(*arguments)

    monkeypatch.setattr(retrying_arm, "wait_until", wait_until)
    return paused


@pytest.fixture
def simulated(monkeypatch, camera):
    arm = SimulatedArm(camera)
    monkeypatch.setattr(retrying_arm, "ArmClient", lambda: arm)
    return arm


def test_rejected_command_becomes_hold_until_accepted(arm, retrying):
    arm.failures = [CommandError("rejected"), CommandError("rejected again")]
    assert retrying.execute(FORWARD) is REACHED
    assert arm.calls == [("move", 0.1, 0.0, 0.0), ("move", 0.0, 0.0, 0.0), ("move", 0.0, 0.0, 0.0)]
    assert retrying.was_held
    assert problem(retrying).startswith("arm held still: rejected again (attempt 2 of 6, next in ")
    retrying.observe(REACHED)
    assert problem(retrying) == ""
    retrying.execute(FORWARD)
    assert not retrying.was_held


def test_go_to_retries_rejected_pose(arm, retrying):
    arm.failures = [CommandError("rejected")]
    retrying.go_to((0.4, 0.1, 1.0))
    assert arm.calls == 2 * [("go_to", 0.4, 0.1, 1.0)]
    assert problem(retrying) == ""


def test_observe_holds_still_until_image(arm, camera, retrying):
    camera.failures = [ObservationError("no image")]
    image, state = retrying.observe(REACHED)
    assert (image.header.stamp, image.height, image.width, state) == (REACHED.header.stamp, 2, 2, REACHED)
    assert arm.calls == [("move", 0.0, 0.0, 0.0)]
    assert retrying.was_held


@pytest.mark.parametrize("act", [lambda arm: arm.execute(FORWARD), lambda arm: arm.go_to((0.4, 0.1, 1.0))])
def test_timeout_raises_last_rejection(arm, camera, act):
    retrying = retrying_arm.RetryingArm(Config(), timeout=0.2)
    arm.failures = [ArmBusyError(f"rejection {count}") for count in range(10**4)]
    with pytest.raises(ArmBusyError, match="rejection") as rejection:
        act(retrying)
    assert str(rejection.value) == f"rejection {len(arm.calls) - 1}"
    assert len(arm.calls) > 1
    assert problem(retrying) == "", "nothing is retried any more"


def test_timeout_raises_missing_image(arm, camera):
    retrying = retrying_arm.RetryingArm(Config(), timeout=0.0)
    camera.failures = [ObservationError("no image")]
    with pytest.raises(ObservationError, match="no image"):
        retrying.observe(REACHED)
    assert arm.calls == []


def test_observe_timeout_includes_rejected_commands(arm, camera, clock):
    retrying = retrying_arm.RetryingArm(Config(), timeout=0.2)
    camera.failures = [ObservationError("no image")]
    arm.failures = [ArmStoppedError("rejected") for _ in range(10**4)]
    with pytest.raises(CommandError, match="rejected"):
        retrying.observe(REACHED)
    assert clock.now == pytest.approx(0.2)


@pytest.mark.parametrize("error_class", [CommandError, ArmFailedError])
@pytest.mark.parametrize("act", [lambda arm: arm.execute(FORWARD), lambda arm: arm.go_to((0.4, 0.1, 1.0))])
def test_failing_arm_is_given_up_and_stopped(arm, retrying, act, error_class):
    arm.failures = [error_class("in reflex mode") for _ in range(10**4)]
    with pytest.raises(error_class, match=r"in reflex mode \(gave up after 6 attempts\)"):
        act(retrying)
    assert len(arm.calls) == 6
    assert problem(retrying) == "", "nothing is retried any more"
    arm.failures.clear()
    retrying.stop()
    assert arm.calls[-1] == ("stop",), "the arm may still move"


def test_successful_hold_does_not_reset_failure_count(arm, retrying):
    def step():
        arm.failures = [CommandError("rejected")]
        retrying.execute(FORWARD)

    for _ in range(5):
        step()
    with pytest.raises(CommandError, match="gave up after 6 attempts"):
        step()


def test_success_resets_failure_count(arm, retrying):
    for _ in range(3):
        arm.failures = [ArmFailedError("in reflex mode") for _ in range(5)]
        retrying.execute(FORWARD)
        retrying.execute(FORWARD)
    assert arm.calls[-1] == ("move", 0.1, 0.0, 0.0)


@pytest.mark.parametrize("error_class", [ArmStoppedError, ArmBusyError, NoResponseError])
def test_uncounted_failures_are_retried_forever(arm, retrying, error_class):
    arm.failures = [error_class("not now") for _ in range(20)]
    assert retrying.execute(FORWARD) is REACHED
    assert len(arm.calls) == 21
    assert retrying.health(Health(message="exploring")) == Health(ERROR, "arm held still: not now")


def test_health_reports_pause_and_what_it_waits_for(retrying):
    assert retrying.health(Health(message="exploring")) == Health(message="exploring")
    retrying.pause("a call of /planner/resume")
    assert retrying.health(Health(message="exploring")) == Health(
        WARN, "paused, waiting for a call of /planner/resume", idle=True
    )


@pytest.fixture
def clock(monkeypatch):
    """The clock of pauses, timeouts and the lease, whose heartbeats are sent while it passes."""
    clock = SimpleNamespace(now=0.0)

    def start_timer(period, function):
        def passes(seconds):
            for _ in range(round(seconds / period)):
                clock.now += period
                function()

        clock.passes = passes

    monkeypatch.setattr(lease, "WallTimer", start_timer)

    def sleep(seconds):
        clock.now += seconds

    for module in (lease, retry_policy):
        monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: clock.now))
    monkeypatch.setattr(retrying_arm, "wall_sleep", sleep)
    return clock


def test_heartbeats_keep_control_until_stop(arm, camera, clock):
    timeout = Config().arm.commander_timeout
    retrying = retrying_arm.RetryingArm(Config())
    clock.passes(2.0 * timeout)
    assert arm.heartbeats == 0, "nothing was commanded yet"
    retrying.execute(FORWARD)
    clock.passes(2.0 * timeout)
    assert arm.heartbeats == 2 * lease.HEARTBEATS
    assert retrying.in_control, "beyond the timeout of the command"
    retrying.stop()
    sent = arm.heartbeats
    clock.passes(timeout)
    assert arm.heartbeats == sent
    assert not retrying.in_control


def test_denied_heartbeat_ends_control(arm, camera, clock):
    arm.heartbeat = lambda: False
    retrying = retrying_arm.RetryingArm(Config())
    retrying.execute(FORWARD)
    assert retrying.in_control
    clock.passes(Config().arm.commander_timeout / lease.HEARTBEATS)
    assert not retrying.in_control, "before the timeout of the command"
    retrying.stop()
    assert ("stop",) not in arm.calls


def test_stop_is_sent_without_response_to_heartbeat(arm, retrying):
    """As while the node shuts down."""

    def fail():
        raise NoResponseError("no response")

    retrying.execute(FORWARD)
    arm.heartbeat = fail
    retrying.stop()
    assert arm.calls[-1] == ("stop",)


def test_stop_releases_control_once(arm, retrying):
    retrying.execute(FORWARD)
    assert retrying.in_control
    retrying.stop()
    assert not retrying.in_control
    retrying.stop()
    assert arm.calls.count(("stop",)) == 1


def test_stop_without_control_sends_nothing(arm, retrying):
    arm.failures = [ArmBusyError("controlled by another node") for _ in range(10**4)]
    command = in_a_thread(retrying.execute, FORWARD)
    wait_for(lambda: len(arm.calls) > 2)
    retrying.stop()
    assert ("stop",) not in arm.calls
    arm.failures.clear()
    command.join(10.0)


def test_stop_after_command_without_response(arm, camera):
    retrying = retrying_arm.RetryingArm(Config(), timeout=0.0)
    arm.failures = [NoResponseError("the connection broke")]
    with pytest.raises(CommandError, match="broke"):
        retrying.execute(FORWARD)
    retrying.stop()
    assert arm.calls[-1] == ("stop",)


def test_late_stop_raises_and_happens_later(arm, retrying):
    retrying.execute(FORWARD)
    arm.failures = [CommandError("it keeps moving")]
    with pytest.raises(CommandError, match="keeps moving"):
        retrying.stop()
    arm.responds.clear()
    step = in_a_thread(retrying.execute, FORWARD)
    wait_for(lambda: arm.calls[-1][0] == "move")
    with pytest.raises(CommandError, match=r"not responded within 0\.1 s"):
        retrying.stop(0.1)
    arm.responds.set()
    step.join(10.0)
    wait_for(lambda: not retrying.in_control)
    assert arm.calls[-1] == ("stop",)


def test_stop_during_pause_follows_command_in_progress(arm, retrying, paused):
    retrying.execute(FORWARD)
    arm.responds.clear()
    step = in_a_thread(retrying.execute, FORWARD)
    wait_for(lambda: len(arm.calls) == 2)
    retrying.pause("a call")
    with pytest.raises(CommandError, match="not responded"):
        retrying.stop(0.1)
    assert len(arm.calls) == 2, "the command in progress has not returned"
    arm.responds.set()
    step.join(10.0)
    wait_for(lambda: not retrying.in_control)
    later = in_a_thread(retrying.execute, FORWARD)
    assert paused.wait(10.0)
    assert arm.calls[2:] == [("stop",)]
    retrying.resume()
    later.join(10.0)
    assert arm.calls[3:] == [("move", 0.0, 0.0, 0.0)], "the velocity was planned before the pause"
    assert retrying.was_held


class InterruptibleArm(Arm):
    """A go_to ends with an error when the arm is stopped."""

    def __init__(self):
        super().__init__()
        self.stopped = threading.Event()

    def go_to(self, pose):
        self.calls.append(("go_to", *pose))
        assert self.stopped.wait(10.0)
        raise ArmFailedError("stopped")

    def stop(self):
        self.calls.append(("stop",))
        self.stopped.set()


def test_cancel_stops_command_in_progress_without_retry(monkeypatch, camera):
    arm = InterruptibleArm()
    monkeypatch.setattr(retrying_arm, "ArmClient", lambda: arm)
    retrying = retrying_arm.RetryingArm(Config())

    def cancel():
        wait_for(lambda: arm.calls)
        retrying.cancel()

    cancelling = in_a_thread(cancel)
    with pytest.raises(ArmFailedError, match="stopped"):
        retrying.go_to((0.4, 0.1, 1.0))
    cancelling.join(10.0)
    assert arm.calls == [("go_to", 0.4, 0.1, 1.0), ("stop",)]


def test_cancel_and_stop_at_once_are_one_stop(simulated):
    """The second of two stops would come from a node without control, which is an emergency stop."""
    retrying = retrying_arm.RetryingArm(Config())
    retrying.execute(FORWARD)
    both, ask = threading.Barrier(2), simulated.heartbeat

    def heartbeat():
        granted = ask()
        with contextlib.suppress(threading.BrokenBarrierError):  # the other one has not asked
            both.wait(0.2)
        return granted

    simulated.heartbeat = heartbeat
    cancelling = in_a_thread(retrying.cancel)
    retrying.stop()
    cancelling.join(10.0)
    assert (simulated.calls.count(("stop",)), simulated.emergency_stops) == (1, 0)


def test_pause_suspends_retries(arm, camera, retrying, paused):
    camera.failures = [ObservationError("no image") for _ in range(10**4)]
    look = in_a_thread(retrying.observe, REACHED)
    wait_for(lambda: len(arm.calls) > 2)
    retrying.pause("a call")
    retrying.stop()
    assert paused.wait(10.0)
    assert arm.calls[-1] == ("stop",)
    camera.failures.clear()
    retrying.resume()
    look.join(10.0)
    assert not look.is_alive()


def kinds(arm):
    """Names of the calls; those of restore with their argument."""
    return [call if call[0] == "restore" else call[0] for call in arm.calls]


def test_restarted_simulation_is_restored_before_command(simulated):
    retrying = retrying_arm.RetryingArm(Config())
    retrying.execute(FORWARD)
    simulated.restart()
    assert retrying.in_control, "it returns to where it was left"
    assert retrying.execute(FORWARD).header.stamp == rospy.Time(2)
    assert kinds(simulated) == ["move", ("restore", 1.0), "move"]
    assert not retrying.was_held, "the restart has no effect"


def test_command_is_repeated_after_simulation_restart(simulated):
    retrying = retrying_arm.RetryingArm(Config())
    retrying.execute(FORWARD)
    simulated.is_dead = True
    step = in_a_thread(retrying.execute, FORWARD)
    wait_for(lambda: len(simulated.calls) > 3)
    assert problem(retrying) == "arm held still: no response"
    simulated.restart()
    step.join(10.0)
    assert kinds(simulated)[-2:] == [("restore", 1.0), "move"]
    assert simulated.calls[-1] == ("move", 0.1, 0.0, 0.0)
    assert not retrying.was_held


@pytest.mark.parametrize("act", [lambda arm: arm.execute(FORWARD), lambda arm: arm.go_to((0.4, 0.1, 1.0))])
def test_timeout_ends_wait_for_dead_simulation(simulated, act):
    retrying = retrying_arm.RetryingArm(Config(), timeout=0.0)
    retrying.execute(FORWARD)
    simulated.is_dead = True
    with pytest.raises(NoResponseError, match="no response"):
        act(retrying)
    assert problem(retrying) == "", "nothing is retried any more"
    assert not retrying.was_held


def test_timeout_of_observe_ends_wait_for_dead_simulation(simulated, camera):
    retrying = retrying_arm.RetryingArm(Config(), timeout=0.0)
    reached = retrying.execute(FORWARD)
    simulated.is_dead = True
    camera.failures = [ObservationError("no image")]
    with pytest.raises(NoResponseError, match="no response"):
        retrying.observe(reached)


def test_cancel_ends_wait_for_dead_simulation(simulated):
    retrying = retrying_arm.RetryingArm(Config())
    retrying.execute(FORWARD)
    simulated.is_dead = True

    def cancel():
        wait_for(lambda: len(simulated.calls) > 3)
        retrying.cancel()

    cancelling = in_a_thread(cancel)
    with pytest.raises(NoResponseError, match="no response"):
        retrying.go_to((0.4, 0.1, 1.0))
    cancelling.join(10.0)
    assert problem(retrying) == "", "nothing is retried any more"


def test_simulation_is_restored_after_timeout(simulated):
    retrying = retrying_arm.RetryingArm(Config(), timeout=0.0)
    retrying.execute(FORWARD)
    simulated.is_dead = True
    with pytest.raises(NoResponseError):
        retrying.execute(FORWARD)
    simulated.restart()
    retrying.execute(FORWARD)
    assert kinds(simulated)[-2:] == [("restore", 1.0), "move"]


def test_response_of_restarted_simulation_is_discarded(simulated, camera):
    retrying = retrying_arm.RetryingArm(Config())
    for _ in range(3):
        retrying.execute(FORWARD)
    restarts = camera.restarts
    simulated.restart()
    camera.restarts = restarts  # its states have not come yet
    assert retrying.execute(FORWARD).header.stamp == rospy.Time(4)
    assert kinds(simulated)[3:] == ["move", ("restore", 3.0), "move"]


def test_image_is_repeated_after_simulation_restart(simulated, camera):
    retrying = retrying_arm.RetryingArm(Config())
    reached = retrying.execute(FORWARD)
    simulated.is_dead = True
    camera.failures = [ObservationError("no image")]
    look = in_a_thread(retrying.observe, reached)
    wait_for(lambda: len(simulated.calls) > 2)
    simulated.restart()
    look.join(10.0)
    assert set(kinds(simulated)[1:]) == {("restore", 1.0)}
    assert not retrying.was_held


def test_silent_camera_of_simulation_holds_arm(simulated, camera):
    retrying = retrying_arm.RetryingArm(Config())
    reached = retrying.execute(FORWARD)
    camera.failures = [ObservationError("no image"), ObservationError("no image")]
    retrying.observe(reached)
    assert kinds(simulated) == ["move", ("restore", 1.0), "move"]
    assert simulated.calls[-1] == ("move", 0.0, 0.0, 0.0)
    assert retrying.was_held


def test_pause_persists_across_simulation_restart(simulated, paused):
    retrying = retrying_arm.RetryingArm(Config())
    retrying.execute(FORWARD)
    simulated.is_dead = True
    step = in_a_thread(retrying.execute, FORWARD)
    wait_for(lambda: len(simulated.calls) > 2)
    retrying.pause("a call")
    with pytest.raises(CommandError, match="no response"):
        retrying.stop()
    count = len(simulated.calls)
    simulated.restart()
    assert paused.wait(10.0)
    assert len(simulated.calls) == count
    retrying.resume()
    step.join(10.0)
    assert simulated.calls[-1] == ("move", 0.0, 0.0, 0.0)
    assert retrying.was_held


def test_stop_of_restarted_simulation_is_no_emergency_stop(simulated):
    retrying = retrying_arm.RetryingArm(Config())
    retrying.execute(FORWARD)
    simulated.restart()
    retrying.stop()
    assert simulated.emergency_stops == 0
    retrying.execute(FORWARD)
    retrying.stop()
    assert simulated.calls[-1] == ("stop",)
    assert simulated.emergency_stops == 0


def test_stop_of_simulation_releases_control(simulated):
    retrying = retrying_arm.RetryingArm(Config())
    retrying.execute(FORWARD)
    assert retrying.in_control
    retrying.stop()
    assert not retrying.in_control


def test_simulation_stopped_by_timeout_returns_before_command(simulated):
    """As after a freeze of the commander: the brake of the arm has no effect on the run."""
    retrying = retrying_arm.RetryingArm(Config())
    retrying.execute(FORWARD)
    simulated.brake()
    assert retrying.in_control, "it returns to where it was left"
    assert retrying.execute(FORWARD).header.stamp == rospy.Time(2)
    assert kinds(simulated) == ["move", ("restore", 1.0), "move"]
    assert not retrying.was_held


def test_simulation_stopped_by_timeout_returns_before_image(simulated, camera):
    retrying = retrying_arm.RetryingArm(Config())
    reached = retrying.execute(FORWARD)
    simulated.brake()
    camera.stamps = [rospy.Time(2)]  # this image has replaced the one at the state reached
    image, _ = retrying.observe(reached)
    assert image.header.stamp == reached.header.stamp
    assert set(kinds(simulated)[1:]) == {("restore", 1.0)}
    assert not retrying.was_held


def test_simulation_moved_after_release_is_not_restored(simulated):
    retrying = retrying_arm.RetryingArm(Config())
    retrying.execute(FORWARD)
    retrying.stop()
    simulated.brake()
    retrying.execute(FORWARD)
    assert kinds(simulated) == ["move", "stop", "move"]


def test_restore_returns_to_stamp(simulated):
    retrying = retrying_arm.RetryingArm(Config())
    reached = retrying.execute(FORWARD)
    retrying.execute(FORWARD)
    assert retrying.restore(reached).header.stamp == reached.header.stamp
    assert not retrying.was_held


def test_restore_of_unknown_state_is_not_retried(simulated):
    retrying = retrying_arm.RetryingArm(Config())
    simulated.saved = ()
    with pytest.raises(CommandError, match="no saved arm state"):
        retrying.restore(REACHED)
    assert kinds(simulated) == [("restore", 1)]


def test_restore_rejects_another_state_of_that_stamp(simulated):
    retrying = retrying_arm.RetryingArm(Config())
    with pytest.raises(CommandError, match="restore failed"):
        retrying.restore(state_message(rospy.Time(1), (0.4, 0.0, 0.0), (0.0, 0.0, 0.0)))


def test_lost_state_of_restarted_simulation_ends_control(simulated):
    """The arm is then held where it is, and was_held reports it."""
    retrying = retrying_arm.RetryingArm(Config())
    retrying.execute(FORWARD)
    simulated.saved = ()
    simulated.restart()
    retrying.execute(FORWARD)
    assert kinds(simulated) == ["move", ("restore", 1), "move"]
    assert simulated.calls[-1] == ("move", 0.0, 0.0, 0.0)
    assert retrying.was_held
