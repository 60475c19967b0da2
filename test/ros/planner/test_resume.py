"""What a planner remembers between two lives, and when it does not trust its memory."""

import numpy as np
import pytest
import rospy

from embodied_active_learning.config import Config
from embodied_active_learning.pipeline.exploration import ExplorationRun
from embodied_active_learning.ros.conversions import state_arrays, state_message
from embodied_active_learning.ros.planner.resume import PlannerResume

CONFIG = Config.from_dict({"exploration": {"samples": 50, "fresh_samples": 5}})
TRAJECTORY = np.array([[0.45, 0.01, 0.1], [0.46, 0.02, 0.2], [0.47, 0.03, 0.3]])
VELOCITY = np.array([0.05, 0.05, 0.5])


@pytest.fixture
def memory(tmp_path):
    """A memory that was written as the third observation was about to be handed over."""
    written = PlannerResume(CONFIG, tmp_path)
    run = ExplorationRun(CONFIG, TRAJECTORY[:2])
    written.remember(run, state_message(rospy.Time(7, 8), TRAJECTORY[2], VELOCITY))
    return written


@pytest.fixture
def warned(monkeypatch):
    lines = []
    monkeypatch.setattr(rospy, "logwarn", lambda text, *values: lines.append(text % values))
    return lines


def test_an_observation_that_was_not_stored_is_taken_again(memory, warned):
    recalled = memory.recall(TRAJECTORY[:2])
    assert not recalled.is_stored
    assert recalled.run.step == 2
    assert recalled.state.header.stamp == rospy.Time(7, 8)
    np.testing.assert_array_equal(state_arrays(recalled.state)[0], TRAJECTORY[2])
    assert warned == []


def test_an_observation_that_was_stored_is_counted_with_its_stamp_and_velocity(memory, warned):
    recalled = memory.recall(TRAJECTORY)
    assert recalled.run.step == 2
    assert recalled.is_stored
    assert recalled.state.header.stamp == rospy.Time(7, 8)
    np.testing.assert_array_equal(np.concatenate(state_arrays(recalled.state)), [*TRAJECTORY[2], *VELOCITY])
    assert warned == []


def test_a_run_that_begins_remembers_nothing_and_that_is_no_trouble(tmp_path, warned):
    assert PlannerResume(CONFIG, tmp_path).recall(np.empty((0, 3))) is None
    assert warned == []


@pytest.mark.parametrize(
    ("trajectory", "words"),
    [
        (TRAJECTORY[:1], "does not tell of observation 1"),
        (np.concatenate([TRAJECTORY, TRAJECTORY]), "does not tell of observation 6"),
        (TRAJECTORY + 1e-9, "is of another run"),
    ],
)
def test_a_memory_that_does_not_fit_what_is_stored_is_not_used_and_that_is_said(memory, warned, trajectory, words):
    assert memory.recall(trajectory) is None
    assert "with other random draws" in warned[0]
    assert words in warned[0]


def test_a_damaged_memory_is_not_used_and_that_is_said(memory, warned, tmp_path):
    path = tmp_path / "planner.safetensors"
    path.write_bytes(path.read_bytes()[:-1])
    assert memory.recall(TRAJECTORY) is None
    assert str(path) in warned[0]
