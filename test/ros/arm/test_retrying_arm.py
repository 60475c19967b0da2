"""Moving and looking with patience, and pauses, with an arm and a camera that fail on demand and without a master."""

import threading
import time
from dataclasses import replace

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
from embodied_active_learning.ros.arm import retrying_arm
from embodied_active_learning.ros.arm.client import Reached
from embodied_active_learning.ros.conversions import image_message, state_message
from embodied_active_learning.ros.runtime.diagnostics import ERROR, WARN, Health
from threads import in_a_thread, wait_for

FORWARD = VelocityCommand(0.1, 0.0, 0.0, 0.2)
REACHED = state_message(rospy.Time(1), (0.5, 0.0, 0.0), (0.0, 0.0, 0.0))


class Arm:
    """Records what it is told; the next calls fail with `failures`, in their order."""

    def __init__(self):
        self.told = []
        self.failures = []
        self.keeps = 0
        self.answers = threading.Event()
        self.answers.set()

    def move(self, velocity, duration):
        return self._answer(("move", *velocity))

    def go_to(self, pose):
        return self._answer(("go_to", *pose))

    def stop(self):
        self._answer(("stop",))

    def keep(self):
        self.keeps += 1
        return True

    def _answer(self, told):
        self.told.append(told)
        assert self.answers.wait(10.0)
        if self.failures:
            raise self.failures.pop(0)
        return Reached(REACHED, np.empty(0))


class SimulatedArm(Arm):
    """Knows the time that it has moved for, which is also its memory, and who drives it; can be started anew."""

    def __init__(self, camera):
        super().__init__()
        self._camera = camera
        self._time = 0
        self.is_driven = False
        self.is_dead = False
        self.stops_that_last = 0

    def move(self, velocity, duration):
        self._answer(("move", *velocity))
        return self._advance()

    def go_to(self, pose):
        self._answer(("go_to", *pose))
        return self._advance()

    def restore(self, memory):
        self._answer(("restore", *memory))
        return self._be_at(int(memory[0]))

    def stop(self):
        self._answer(("stop",))
        self.stops_that_last += not self.is_driven
        self._advance()
        self.is_driven = False

    def keep(self):
        return self.is_driven

    def begin_anew(self):
        self.is_dead, self.is_driven, self._time = False, False, 0
        self._camera.see_time(0)

    def _advance(self):
        return self._be_at(self._time + 1)

    def _be_at(self, time):
        self._time, self.is_driven = time, True
        self._camera.see_time(time)
        state = state_message(rospy.Time(time), (0.5, 0.0, 0.0), (0.0, 0.0, 0.0))
        return Reached(state, np.array([float(time)]))

    def _answer(self, told):
        super()._answer(told)
        if self.is_dead:
            raise NoResponseError("it does not answer")


class Camera:
    restarts = 0
    newest_state = None

    def __init__(self):
        self.failures = []

    def see_time(self, time):
        stamp = rospy.Time(time)
        self.restarts += self.newest_state is not None and stamp < self.newest_state
        self.newest_state = stamp

    def take(self, after):
        if self.failures:
            raise self.failures.pop(0)
        return image_message(after, np.zeros((2, 2, 3), np.uint8)), REACHED


@pytest.fixture
def arm(monkeypatch):
    arm = Arm()
    monkeypatch.setattr(retrying_arm, "ArmClient", lambda: arm)
    return arm


@pytest.fixture
def camera(monkeypatch):
    camera = Camera()
    monkeypatch.setattr(retrying_arm, "PosedCamera", lambda config: camera)
    monkeypatch.setattr(retrying_arm, "RETRY_PERIOD", 0.01)
    return camera


@pytest.fixture
def guided(arm, camera):
    return retrying_arm.RetryingArm(Config())


@pytest.fixture
def simulated(monkeypatch, camera):
    arm = SimulatedArm(camera)
    monkeypatch.setattr(retrying_arm, "ArmClient", lambda: arm)
    return arm


def test_a_refused_command_becomes_standing_still_until_the_arm_takes_that(arm, guided):
    arm.failures = [CommandError("refused"), CommandError("refused again")]
    assert guided.execute(FORWARD) is REACHED
    assert arm.told == [("move", 0.1, 0.0, 0.0), ("move", 0.0, 0.0, 0.0), ("move", 0.0, 0.0, 0.0)]
    assert guided.held
    assert guided.trouble.startswith("refused again (try 2 of 6, the next in ")
    guided.look(REACHED)
    assert guided.trouble == ""
    guided.execute(FORWARD)
    assert not guided.held


def test_a_pose_that_was_refused_is_tried_again(arm, guided):
    arm.failures = [CommandError("refused")]
    guided.go_to((0.4, 0.1, 1.0))
    assert arm.told == 2 * [("go_to", 0.4, 0.1, 1.0)]
    assert guided.trouble == ""


def test_an_image_is_awaited_standing_still(arm, camera, guided):
    camera.failures = [ObservationError("no image")]
    image, state = guided.look(REACHED)
    assert (image.header.stamp, image.height, image.width, state) == (REACHED.header.stamp, 2, 2, REACHED)
    assert arm.told == [("move", 0.0, 0.0, 0.0)]
    assert guided.held


@pytest.mark.parametrize("act", [lambda arm: arm.execute(FORWARD), lambda arm: arm.go_to((0.4, 0.1, 1.0))])
def test_when_patience_has_ended_the_last_refusal_is_raised(arm, camera, act):
    guided = retrying_arm.RetryingArm(Config(), patience=0.2)
    arm.failures = [ArmBusyError(f"refusal {count}") for count in range(10**4)]
    with pytest.raises(ArmBusyError, match="refusal") as refusal:
        act(guided)
    assert str(refusal.value) == f"refusal {len(arm.told) - 1}"
    assert len(arm.told) > 1
    assert guided.trouble == "", "nobody is trying any more"


def test_when_patience_has_ended_the_missing_image_is_told(arm, camera):
    guided = retrying_arm.RetryingArm(Config(), patience=0.0)
    camera.failures = [ObservationError("no image")]
    with pytest.raises(ObservationError, match="no image"):
        guided.look(REACHED)
    assert arm.told == []


def test_patience_for_an_image_counts_the_refusals_meanwhile(arm, camera):
    guided = retrying_arm.RetryingArm(Config(), patience=0.2)
    camera.failures = [ObservationError("no image")]
    arm.failures = [ArmStoppedError("refused") for _ in range(10**4)]
    started = time.monotonic()
    with pytest.raises(CommandError, match="refused"):
        guided.look(REACHED)
    assert time.monotonic() - started < 2.0


@pytest.mark.parametrize("error_class", [CommandError, ArmFailedError])
@pytest.mark.parametrize("act", [lambda arm: arm.execute(FORWARD), lambda arm: arm.go_to((0.4, 0.1, 1.0))])
def test_an_arm_that_goes_on_failing_is_given_up_and_stopped(arm, guided, act, error_class):
    arm.failures = [error_class("in reflex mode") for _ in range(10**4)]
    with pytest.raises(error_class, match=r"in reflex mode \(gave up after 6 tries\)"):
        act(guided)
    assert len(arm.told) == 6
    assert guided.trouble == "", "nobody is trying any more"
    arm.failures.clear()
    guided.stop()
    assert arm.told[-1] == ("stop",), "it may still move"


def test_an_arm_that_can_only_stand_still_is_given_up_as_well(arm, guided):
    def step():
        arm.failures = [CommandError("refused")]
        guided.execute(FORWARD)

    for _ in range(5):
        step()
    with pytest.raises(CommandError, match="gave up after 6 tries"):
        step()


def test_an_arm_that_recovers_within_its_tries_has_them_all_again(arm, guided):
    for _ in range(3):
        arm.failures = [ArmFailedError("in reflex mode") for _ in range(5)]
        guided.execute(FORWARD)
        guided.execute(FORWARD)
    assert arm.told[-1] == ("move", 0.1, 0.0, 0.0)


def test_tries_come_at_growing_intervals(arm, guided, monkeypatch):
    waits = []
    monkeypatch.setattr(retrying_arm, "wall_sleep", waits.append)
    monkeypatch.setattr(retrying_arm, "LONGEST_RETRY_PERIOD", 0.05)
    arm.failures = [ArmFailedError("in reflex mode") for _ in range(5)]
    guided.execute(FORWARD)
    assert waits == [0.01, 0.02, 0.04, 0.05, 0.05]


@pytest.mark.parametrize("error_class", [ArmStoppedError, ArmBusyError, NoResponseError])
def test_what_only_time_or_a_person_can_mend_is_waited_for(arm, guided, error_class):
    arm.failures = [error_class("not now") for _ in range(20)]
    assert guided.execute(FORWARD) is REACHED
    assert len(arm.told) == 21
    assert guided.health(Health(message="exploring")) == Health(ERROR, "the arm stands still: not now")


def test_health_tells_of_a_pause_and_of_whom_it_awaits(guided):
    assert guided.health(Health(message="exploring")) == Health(message="exploring")
    guided.pause("a call of /planner/resume")
    assert guided.health(Health(message="exploring")) == Health(
        WARN, "paused, waiting for a call of /planner/resume", idle=True
    )


def test_the_arm_is_kept_while_its_driver_waits_and_no_longer_when_it_has_given_it_back(arm, camera):
    timeout = 0.3
    guided = retrying_arm.RetryingArm(replace(Config(), arm=replace(Config().arm, commander_timeout=timeout)))
    time.sleep(timeout)
    assert arm.keeps == 0, "it has not commanded anything yet"
    guided.execute(FORWARD)
    wait_for(lambda: arm.keeps > 4)
    assert guided.is_ours, "longer than the arm grants after a command"
    guided.stop()
    assert not guided.is_ours
    kept = arm.keeps
    time.sleep(timeout)
    assert arm.keeps <= kept + 1, "one may have been under way"
    assert not guided.is_ours


def test_an_arm_that_was_lost_is_not_ours_any_more(arm, camera):
    arm.keep = lambda: False
    guided = retrying_arm.RetryingArm(replace(Config(), arm=replace(Config().arm, commander_timeout=0.3)))
    guided.execute(FORWARD)
    wait_for(lambda: not guided.is_ours)
    guided.stop()
    assert ("stop",) not in arm.told


def test_a_stop_gives_the_arm_back_and_is_asked_for_once(arm, guided):
    guided.execute(FORWARD)
    assert guided.is_ours
    guided.stop()
    assert not guided.is_ours
    guided.stop()
    assert arm.told.count(("stop",)) == 1


def test_an_arm_that_another_node_drives_is_not_stopped(arm, guided):
    arm.failures = [ArmBusyError("driven by another node") for _ in range(10**4)]
    command = in_a_thread(guided.execute, FORWARD)
    wait_for(lambda: len(arm.told) > 2)
    guided.stop()
    assert ("stop",) not in arm.told
    arm.failures.clear()
    command.join(10.0)


def test_an_arm_that_may_have_taken_a_command_is_stopped(arm, camera):
    guided = retrying_arm.RetryingArm(Config(), patience=0.0)
    arm.failures = [NoResponseError("the connection broke")]
    with pytest.raises(CommandError, match="broke"):
        guided.execute(FORWARD)
    guided.stop()
    assert arm.told[-1] == ("stop",)


def test_a_stop_that_fails_or_is_not_answered_is_an_error_and_happens_later(arm, guided):
    guided.execute(FORWARD)
    arm.failures = [CommandError("it keeps moving")]
    with pytest.raises(CommandError, match="keeps moving"):
        guided.stop()
    arm.answers.clear()
    step = in_a_thread(guided.execute, FORWARD)
    wait_for(lambda: arm.told[-1][0] == "move")
    with pytest.raises(CommandError, match=r"not answered within 0\.1 s"):
        guided.stop(0.1)
    arm.answers.set()
    step.join(10.0)
    wait_for(lambda: not guided.is_ours)
    assert arm.told[-1] == ("stop",)


def test_pause_and_resume_tell_whether_they_changed_anything(guided):
    assert not guided.resume()
    assert guided.pause("a call")
    assert not guided.pause("a call")
    assert guided.is_paused
    assert guided.resume()
    assert not guided.is_paused
    assert not guided.wait_while_paused()


def test_a_stop_in_a_pause_comes_after_the_command_under_way_and_nothing_after_it(arm, guided):
    guided.execute(FORWARD)
    arm.answers.clear()
    step = in_a_thread(guided.execute, FORWARD)
    wait_for(lambda: len(arm.told) == 2)
    guided.pause("a call")
    stop = in_a_thread(guided.stop)
    time.sleep(0.1)
    assert len(arm.told) == 2, "the command under way has not been answered"
    arm.answers.set()
    step.join(10.0)
    stop.join(10.0)
    later = in_a_thread(guided.execute, FORWARD)
    time.sleep(0.1)
    assert arm.told[2:] == [("stop",)]
    guided.resume()
    later.join(10.0)
    assert arm.told[3:] == [("move", 0.0, 0.0, 0.0)], "the velocity was chosen for where the arm was before"
    assert guided.held


def test_a_pause_also_ends_the_tries_of_an_arm_in_trouble(arm, camera, guided):
    camera.failures = [ObservationError("no image") for _ in range(10**4)]
    look = in_a_thread(guided.look, REACHED)
    wait_for(lambda: len(arm.told) > 2)
    guided.pause("a call")
    guided.stop()
    time.sleep(0.1)
    assert arm.told[-1] == ("stop",)
    camera.failures.clear()
    guided.resume()
    look.join(10.0)
    assert not look.is_alive()


def moves(arm):
    return [told[0] if told[0] != "restore" else told for told in arm.told]


def test_a_simulated_arm_that_was_started_anew_is_put_back_before_the_next_command(simulated):
    guided = retrying_arm.RetryingArm(Config())
    guided.execute(FORWARD)
    simulated.begin_anew()
    assert guided.is_ours, "it will be where it was left"
    assert guided.execute(FORWARD).header.stamp == rospy.Time(2)
    assert moves(simulated) == ["move", ("restore", 1.0), "move"]
    assert not guided.held, "nothing has happened"


def test_a_command_that_a_simulated_arm_has_not_survived_is_carried_out_again(simulated):
    guided = retrying_arm.RetryingArm(Config())
    guided.execute(FORWARD)
    simulated.is_dead = True
    step = in_a_thread(guided.execute, FORWARD)
    wait_for(lambda: len(simulated.told) > 3)
    assert guided.trouble == "it does not answer"
    simulated.begin_anew()
    step.join(10.0)
    assert moves(simulated)[-2:] == [("restore", 1.0), "move"]
    assert simulated.told[-1] == ("move", 0.1, 0.0, 0.0)
    assert not guided.held


def test_an_answer_of_another_simulated_arm_than_the_one_that_was_there_does_not_count(simulated, camera):
    guided = retrying_arm.RetryingArm(Config())
    for _ in range(3):
        guided.execute(FORWARD)
    restarts = camera.restarts
    simulated.begin_anew()
    camera.restarts = restarts  # its states have not come yet
    assert guided.execute(FORWARD).header.stamp == rospy.Time(4)
    assert moves(simulated)[3:] == ["move", ("restore", 3.0), "move"]


def test_an_image_that_a_simulated_arm_has_not_survived_is_shown_again(simulated, camera):
    guided = retrying_arm.RetryingArm(Config())
    reached = guided.execute(FORWARD)
    simulated.is_dead = True
    camera.failures = [ObservationError("no image")]
    look = in_a_thread(guided.look, reached)
    wait_for(lambda: len(simulated.told) > 2)
    simulated.begin_anew()
    look.join(10.0)
    assert set(moves(simulated)[1:]) == {("restore", 1.0)}
    assert not guided.held


def test_a_camera_that_stays_silent_beside_a_simulated_arm_is_told_of(simulated, camera):
    guided = retrying_arm.RetryingArm(Config())
    reached = guided.execute(FORWARD)
    camera.failures = [ObservationError("no image"), ObservationError("no image")]
    guided.look(reached)
    assert moves(simulated) == ["move", ("restore", 1.0), "move"]
    assert simulated.told[-1] == ("move", 0.0, 0.0, 0.0)
    assert guided.held


def test_a_pause_holds_while_a_simulated_arm_is_started_anew(simulated):
    guided = retrying_arm.RetryingArm(Config())
    guided.execute(FORWARD)
    simulated.is_dead = True
    step = in_a_thread(guided.execute, FORWARD)
    wait_for(lambda: len(simulated.told) > 2)
    guided.pause("a call")
    with pytest.raises(CommandError, match="does not answer"):
        guided.stop()
    told = len(simulated.told)
    simulated.begin_anew()
    time.sleep(0.1)
    assert len(simulated.told) == told
    guided.resume()
    step.join(10.0)
    assert simulated.told[-1] == ("move", 0.0, 0.0, 0.0)
    assert guided.held


def test_a_simulated_arm_that_was_started_anew_is_not_stopped_as_in_an_emergency(simulated):
    guided = retrying_arm.RetryingArm(Config())
    guided.execute(FORWARD)
    simulated.begin_anew()
    guided.stop()
    assert simulated.stops_that_last == 0
    guided.execute(FORWARD)
    guided.stop()
    assert simulated.told[-1] == ("stop",)
    assert simulated.stops_that_last == 0


def test_a_stop_moves_a_simulated_arm_away_from_where_it_was_left(simulated):
    guided = retrying_arm.RetryingArm(Config())
    guided.execute(FORWARD)
    assert guided.is_ours
    guided.stop()
    assert not guided.is_ours
