"""Saving the planner's state, and loading it only if it belongs to the stored observations."""

import numpy as np
import pytest
import rospy

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CommandError
from embodied_active_learning.exploration.commands import PoseCommand
from embodied_active_learning.pipeline.exploration import ExplorationRun
from embodied_active_learning.ros import names
from embodied_active_learning.ros.conversions import state_arrays, state_message
from embodied_active_learning.ros.planner import resume as resume_module
from embodied_active_learning.ros.planner.resume import PlannerResume

CONFIG = Config.from_dict({"exploration": {"samples": 50, "fresh_samples": 5}})
TRAJECTORY = np.array([[0.45, 0.01, 0.1], [0.46, 0.02, 0.2], [0.47, 0.03, 0.3]])
VELOCITY = np.array([0.05, 0.05, 0.5])


@pytest.fixture
def resume(tmp_path):
    """The state saved before the third observation was sent."""
    resume = PlannerResume(CONFIG, tmp_path)
    run = ExplorationRun(CONFIG, TRAJECTORY[:2])
    resume.save(run, state_message(rospy.Time(7, 8), TRAJECTORY[2], VELOCITY))
    return resume


@pytest.fixture
def warned(monkeypatch):
    lines = []
    monkeypatch.setattr(rospy, "logwarn", lambda text, *values: lines.append(text % values))
    return lines


def test_observation_not_stored_is_repeated(resume, warned):
    point = resume.load(TRAJECTORY[:2])
    assert not point.is_stored
    assert point.run.step == 2
    assert point.state.header.stamp == rospy.Time(7, 8)
    np.testing.assert_array_equal(state_arrays(point.state)[0], TRAJECTORY[2])
    assert warned == []


def test_stored_observation_keeps_stamp_and_velocity(resume, warned):
    point = resume.load(TRAJECTORY)
    assert point.run.step == 2
    assert point.is_stored
    assert point.state.header.stamp == rospy.Time(7, 8)
    np.testing.assert_array_equal(np.concatenate(state_arrays(point.state)), [*TRAJECTORY[2], *VELOCITY])
    assert warned == []


def test_new_run_loads_nothing_without_warning(tmp_path, warned):
    assert PlannerResume(CONFIG, tmp_path).load(np.empty((0, 3))) is None
    assert warned == []


@pytest.mark.parametrize(
    ("trajectory", "words"),
    [
        (TRAJECTORY[:1], "does not belong to observation 1"),
        (np.concatenate([TRAJECTORY, TRAJECTORY]), "does not belong to observation 6"),
        (TRAJECTORY + 1e-9, "is of another run"),
    ],
)
def test_state_of_other_observations_ignored_with_warning(resume, warned, trajectory, words):
    assert resume.load(trajectory) is None
    assert "with other random draws" in warned[0]
    assert words in warned[0]


def test_damaged_state_ignored_with_warning(resume, warned, tmp_path):
    path = tmp_path / "planner.safetensors"
    path.write_bytes(path.read_bytes()[:-1])
    assert resume.load(TRAJECTORY) is None
    assert str(path) in warned[0]


class Arm:
    """Records its commands; restoring a simulated arm fails on request."""

    def __init__(self, failure=None):
        self.failure = failure
        self.commands = []

    def restore(self, state):
        if self.failure:
            raise self.failure
        return state

    def execute(self, command):
        self.commands.append(command)
        return state_message(rospy.Time(9), command.state, np.zeros(3))


def test_simulated_arm_restored_exactly(resume, monkeypatch):
    monkeypatch.setattr(resume_module, "is_advertised", lambda name: name == names.ARM_RESTORE)
    point = resume.load(TRAJECTORY)
    assert resume.return_arm(point, Arm()) == (point.state, point.state)


@pytest.mark.parametrize("simulated", [False, True])
def test_arm_returned_to_pose_at_rest(resume, monkeypatch, warned, simulated):
    """As a real arm, or as a simulated one that cannot be restored."""
    monkeypatch.setattr(resume_module, "is_advertised", lambda name: simulated)
    arm = Arm(CommandError("beyond the limits"))
    reached, state = resume.return_arm(resume.load(TRAJECTORY), arm)
    assert arm.commands == [PoseCommand(*TRAJECTORY[2])]
    assert reached.header.stamp == rospy.Time(9)
    assert state.header.stamp == rospy.Time(7, 8)
    np.testing.assert_array_equal(np.concatenate(state_arrays(state)), [*TRAJECTORY[2], 0.0, 0.0, 0.0])
    assert ["no longer bit-identical: beyond the limits" in line for line in warned] == [True] * simulated
