"""Commands to an arm that follows set-points with a lag, on a clock that the tests advance."""

import math

import numpy as np
import pytest

from driver_lab import TICK, DriverLab, Stop
from embodied_active_learning.config import Config
from embodied_active_learning.errors import (
    ArmBusyError,
    ArmFailedError,
    ArmNotReadyError,
    ArmStoppedError,
    CommandError,
)
from embodied_active_learning.franka.mount import CameraMount, CameraPose
from embodied_active_learning.franka.report import CONTROLLER, Controller, RobotMode
from embodied_active_learning.franka.set_point_driver import AT_REST, SetPointDriver

CONFIG = Config.from_dict(
    {
        "arm": {"robot": "franka", "max_speed": 0.1, "max_turn_rate": 0.7},
        "franka": {"max_turn_lead": 0.5, "recoveries": 2},
    }
)
LAG = 0.3
CENTRE = CONFIG.workspace.box().centre
RUNNING = {CONTROLLER: Controller("running", True)}


class Lab(DriverLab):
    """A driver and a robot that follows its set-points while the test advances the time."""

    def __init__(self, config=CONFIG, pose=CENTRE, height=0.0, tilt=(0.0, 0.0)):
        super().__init__(lambda clock: SetPointDriver(config, clock))
        self.mount = CameraMount.from_config(config)
        self.pose = CameraPose(tuple(map(float, pose)), height, tilt)
        self.mode, self.errors = RobotMode.MOVE, ()
        self.sends_states = self.follows = True
        self.push = 0.0  # m/s along y, by hand
        self.sent = []
        self.passes(0.05)

    def end_effector(self):
        transform = np.eye(4)
        transform[:3, 3], transform[:3, :3] = self.mount.end_effector(self.pose)
        return transform.T.ravel()

    def sees(self, end_effector=None):
        values = self.end_effector() if end_effector is None else end_effector
        return self.driver.update_state(self.now, 0.0, values, self.mode, self.errors, ())

    def tick_robot(self):
        self.driver.update_control(controllers=RUNNING)
        set_point = self.driver.tick()
        self.sent.append(set_point)
        if set_point is not None and self.follows:
            share = 1.0 - math.exp(-TICK / LAG)
            planar = [at + share * (to - at) for at, to in zip(self.pose.planar, set_point.planar)]
            height = self.pose.height + share * (set_point.height - self.pose.height)
            tilt = tuple(at + share * (to - at) for at, to in zip(self.pose.tilt, set_point.tilt))
            self.pose = CameraPose(tuple(planar), height, tilt)
        x, y, theta = self.pose.planar
        self.pose = self.pose._replace(planar=(x, y + TICK * self.push, theta))
        if self.sends_states:
            self.sees()

    def starts_moving(self, velocity=(0.1, 0.0, 0.0), duration=1.0, stop=None):
        outcome = self.begins(self.driver.move, velocity, duration, stop or Stop())
        self.passes(0.3)
        assert np.any(np.abs(self.driver._history.velocity) > AT_REST)
        return outcome

    @property
    def velocity(self):
        return np.array(self.driver._stream.velocity)


def test_move_lasts_its_duration_and_returns_measured_state():
    lab = Lab()
    began_at = lab.now
    reached = lab.runs(lab.driver.move, (0.05, -0.02, 0.1), 0.5, Stop())
    assert began_at + 0.5 <= lab.now <= began_at + 0.6
    assert not reached.limited
    np.testing.assert_allclose(reached.pose, lab.pose.planar, atol=2e-3)
    assert 0.02 < reached.velocity[0] < 0.05


def test_moves_join_and_arm_brakes_after_the_last():
    lab = Lab()
    for _ in range(3):
        lab.runs(lab.driver.move, (0.05, 0.0, 0.0), 0.2, Stop())
        assert lab.velocity[0] == pytest.approx(0.05)
    lab.passes(CONFIG.franka.coast - 0.03)
    assert lab.velocity[0] == pytest.approx(0.05)
    lab.passes(0.2)
    np.testing.assert_array_equal(lab.velocity, 0.0)


def test_velocity_above_limits_is_reduced_and_reported():
    lab = Lab()
    assert lab.runs(lab.driver.move, (1.0, 0.0, 0.0), 0.2, Stop()).limited
    assert lab.velocity[0] <= CONFIG.arm.max_speed


@pytest.mark.parametrize(
    ("velocity", "duration", "complaint"),
    [((math.nan, 0.0, 0.0), 0.2, "invalid velocity"), ((0.1, 0.0, 0.0), 60.0, "invalid duration 60.0 s")],
)
def test_invalid_move_is_rejected(velocity, duration, complaint):
    lab = Lab()
    with pytest.raises(CommandError, match=complaint):
        lab.runs(lab.driver.move, velocity, duration, Stop())
    np.testing.assert_array_equal(lab.velocity, 0.0)


def test_go_to_reaches_pose_and_stops():
    lab = Lab()
    target = (0.4, 0.1, -1.0)
    reached = lab.runs(lab.driver.go_to, target, Stop())
    assert np.hypot(*np.subtract(reached.pose, target)[:2]) <= CONFIG.franka.tolerance
    assert np.all(np.abs(reached.velocity) <= AT_REST)


def test_go_to_of_blocked_arm_fails_with_distance():
    lab = Lab()
    lab.follows = False
    with pytest.raises(ArmFailedError, match=r"not reached within .* 0\.100 m and 0\.00 rad away, .* 0\.050 m"):
        lab.runs(lab.driver.go_to, np.add(CENTRE, (0.0, 0.1, 0.0)), Stop())


def test_reflex_at_end_of_go_to_timeout_is_reported():
    """The motion is aborted in the last wait before the timeout."""
    lab = Lab()
    lab.follows = False
    outcome = lab.begins(lab.driver.go_to, np.add(CENTRE, (0.0, 0.1, 0.0)), Stop())
    with lab.driver._changed:
        lab.now += 60.0
        lab.mode, lab.errors = RobotMode.REFLEX, ("cartesian_reflex",)
        lab.sees()
        lab.driver.tick()
    with pytest.raises(ArmFailedError, match=r"motion aborted: .*cartesian_reflex"):
        lab.ends(outcome)


def test_go_to_outside_workspace_is_rejected():
    lab = Lab()
    with pytest.raises(CommandError, match="outside the workspace"):
        lab.runs(lab.driver.go_to, (1.5, 0.0, 0.0), Stop())


def test_stale_state_aborts_move_until_states_return():
    lab = Lab()
    outcome = lab.starts_moving()
    lab.sends_states = False
    lab.passes(0.25)
    with pytest.raises(ArmFailedError, match=r"aborted: no new robot state"):
        lab.ends(outcome)
    assert lab.sent[-1] is None
    with pytest.raises(ArmNotReadyError, match="no new robot state"):
        lab.runs(lab.driver.move, (0.1, 0.0, 0.0), 0.2, Stop())
    lab.sends_states = True
    lab.passes(0.02)
    lab.passes(0.01)
    np.testing.assert_allclose(lab.sent[-1].planar, lab.pose.planar, atol=1e-9)
    np.testing.assert_array_equal(lab.velocity, 0.0)


def test_repeated_state_counts_as_stale():
    lab = Lab()
    stamp = lab.now
    lab.sends_states = False
    for _ in range(30):
        lab.passes(TICK)
        lab.driver.update_state(stamp, 0.0, lab.end_effector(), lab.mode, (), ())
    assert "no new robot state" in lab.driver.why_not_ready()


def test_non_finite_state_aborts_move():
    lab = Lab()
    outcome = lab.starts_moving()
    lab.sends_states = False
    lab.now += TICK
    assert lab.sees(np.full(16, math.nan)) is None
    assert lab.driver.tick() is None
    with pytest.raises(ArmFailedError, match="not finite"):
        lab.ends(outcome)


def test_pose_jump_aborts_move_and_holds_new_pose():
    lab = Lab()
    outcome = lab.starts_moving()
    x, y, theta = lab.pose.planar
    lab.pose = lab.pose._replace(planar=(x, y + 0.08, theta))
    lab.passes(0.02)
    with pytest.raises(ArmFailedError, match=r"the robot's pose jumped by 0\.0[78]"):
        lab.ends(outcome)
    assert lab.driver.jumps == 1
    assert lab.sent[-1].planar == pytest.approx(lab.pose.planar)
    lab.runs(lab.driver.move, (0.0, 0.0, 0.0), 0.1, Stop())


def test_reflex_aborts_move_and_rejects_later_commands():
    lab = Lab()
    outcome = lab.starts_moving()
    lab.mode, lab.errors = RobotMode.REFLEX, ("cartesian_reflex",)
    lab.passes(0.03)
    with pytest.raises(ArmFailedError, match="cartesian_reflex"):
        lab.ends(outcome)
    assert lab.sent[-1] is None
    with pytest.raises(ArmBusyError, match="recovery 1 of 2 follows automatically"):
        lab.runs(lab.driver.move, (0.1, 0.0, 0.0), 0.2, Stop())


def test_reflex_at_end_of_move_is_reported():
    """The motion is aborted in the last wait before its end."""
    lab = Lab()
    outcome = lab.starts_moving()
    with lab.driver._changed:
        lab.now += 1.0
        lab.mode, lab.errors = RobotMode.REFLEX, ("cartesian_reflex",)
        lab.sees()
        lab.driver.tick()
    with pytest.raises(ArmFailedError, match=r"motion aborted: .*cartesian_reflex"):
        lab.ends(outcome)


def test_user_stop_aborts_move_until_recovery():
    lab = Lab()
    outcome = lab.starts_moving()
    lab.mode = RobotMode.USER_STOPPED
    lab.passes(0.03)
    with pytest.raises(ArmStoppedError, match="user stop is pressed"):
        lab.ends(outcome)
    lab.mode = RobotMode.MOVE
    lab.passes(0.1)
    with pytest.raises(ArmStoppedError, match="call /arm/recover"):
        lab.runs(lab.driver.move, (0.1, 0.0, 0.0), 0.2, Stop())
    assert lab.sent[-1] is None


def test_stop_aborts_move_and_arm_comes_to_rest():
    lab = Lab()
    stop = Stop("/operator")
    outcome = lab.starts_moving(stop=stop)
    stop.now = True
    lab.passes(0.02)
    with pytest.raises(ArmStoppedError, match="stopped by /operator"):
        lab.ends(outcome)
    before, speed = np.array(lab.pose.planar), lab.velocity[0]
    lab.passes(0.03)
    assert lab.velocity[0] < speed - 0.02, "the command brakes before the stop takes over"
    reached = lab.runs(lab.driver.stop)
    assert np.all(np.abs(reached.velocity) <= AT_REST)
    assert np.hypot(*(lab.pose.planar - before)[:2]) < 0.03
    lab.passes(0.5)
    np.testing.assert_array_equal(lab.velocity, 0.0)


def test_stop_without_states_reports_unknown_rest():
    lab = Lab()
    lab.sends_states = False
    lab.passes(0.3)
    with pytest.raises(ArmFailedError, match="unknown whether the arm is at rest"):
        lab.runs(lab.driver.stop)


def test_stop_of_jumping_arm_reports_unknown_rest():
    lab = Lab()
    lab.follows, lab.push = False, 2.0
    with pytest.raises(ArmFailedError, match="pose jumps from state to state"):
        lab.runs(lab.driver.stop)


def test_stop_of_moving_arm_asks_for_user_stop():
    lab = Lab()
    lab.follows, lab.push = False, 0.02
    lab.passes(0.3)
    with pytest.raises(ArmFailedError, match=r"did not come to rest .* it moves at \[0\.0, 0\.02, .*user stop"):
        lab.runs(lab.driver.stop)


def test_set_point_does_not_follow_arm_after_failed_stop():
    lab = Lab()
    lab.sends_states = False
    lab.passes(0.3)
    with pytest.raises(ArmFailedError):
        lab.runs(lab.driver.stop)
    lab.sends_states, lab.follows = True, False
    lab.passes(0.1)
    x, y, theta = lab.pose.planar
    lab.pose = lab.pose._replace(planar=(x, y + 0.005, theta))
    lab.passes(0.5)
    assert lab.sent[-1].planar == pytest.approx((x, y, theta))


def test_move_fails_when_ticks_end():
    lab = Lab()
    outcome = lab.begins(lab.driver.move, (0.1, 0.0, 0.0), 1.0, Stop())
    with lab.driver._changed:
        lab.now += 0.6
        lab.sees()
    with pytest.raises(ArmFailedError, match=r"aborted: no set-point was sent for 0\.6 s"):
        lab.ends(outcome)


def test_robot_without_ticks_is_not_ready():
    lab = Lab()
    lab.now += 0.6
    lab.sees()
    assert "no set-point was sent for 0.6 s" in lab.driver.why_not_ready()
    with pytest.raises(ArmFailedError, match="unknown whether the arm is at rest: no set-point was sent"):
        lab.driver.stop()
    lab.passes(0.2)
    assert lab.driver.why_not_ready() == ""


def test_outdated_list_of_controllers_aborts_move():
    """The supervisor hangs: another controller may have been started."""
    lab = Lab()
    outcome = lab.starts_moving()
    with lab.driver._changed:
        lab.now += 3.1
        lab.sees()
        lab.driver.tick()
    with pytest.raises(ArmFailedError, match=r"controllers and publishers of set-points are unknown for 3\.1 s"):
        lab.ends(outcome)
    lab.passes(0.1)
    assert lab.driver.why_not_ready() == ""


@pytest.mark.parametrize(
    ("place", "complaint"),
    [
        ({"height": 0.05}, r"0\.050 m above its height"),
        ({"height": -0.05}, r"0\.050 m below its height"),
        ({"tilt": (0.0, 0.2)}, r"tilted 0\.20 rad from straight down"),
        ({"pose": (0.8, 0.0, 0.0)}, r"0\.175 m outside workspace/x"),
        ({"pose": (0.5, 0.0, -2.9)}, r"0\.900 rad outside workspace/theta"),
    ],
)
def test_motion_does_not_start_far_from_plane_or_workspace(place, complaint):
    lab = Lab(**place)
    with pytest.raises(ArmNotReadyError, match=complaint):
        lab.runs(lab.driver.move, (0.0, 0.0, 0.0), 0.1, Stop())
    lab.passes(0.3)
    assert lab.sent[-1] == lab.sent[1]


def test_small_pose_errors_are_corrected_during_motion():
    lab = Lab(pose=(0.64, 0.0, 0.0), height=0.02, tilt=(0.1, 0.0))
    lab.runs(lab.driver.go_to, (0.6, 0.0, 0.0), Stop())
    lab.runs(lab.driver.move, (0.0, 0.0, 0.0), 1.0, Stop())
    assert abs(lab.pose.height) < 0.003
    assert lab.pose.tilt_angle < 0.02


def test_pushed_arm_pulls_set_point_along():
    lab = Lab()
    lab.follows = False
    for _ in range(40):
        x, y, theta = lab.pose.planar
        lab.pose = lab.pose._replace(planar=(x, y + 0.003, theta))
        lab.passes(TICK)
    assert lab.driver.displacements == 1
    assert lab.driver.lead()[0] == pytest.approx(CONFIG.franka.max_lead, abs=0.004)
