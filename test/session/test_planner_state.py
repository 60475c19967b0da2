"""The planner's memory on disk: it comes back bit for bit, or is refused by name."""

import dataclasses

import numpy as np
import pytest

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.pipeline.exploration import ExplorationRun
from embodied_active_learning.session.array_files import read_arrays, write_arrays
from embodied_active_learning.session.planner_state import PlannerState, load_planner_state, save_planner_state


@pytest.fixture
def memory():
    run = ExplorationRun(Config.from_dict({"exploration": {"samples": 50, "fresh_samples": 5}}))
    run.observe(np.array([0.475, 0.0, 0.0]), np.zeros(3))
    run.evaluate_step(None)
    run.next_command()
    state, velocity = np.array([0.4, 0.1, 0.2]), np.array([0.1, 0.0, np.pi])
    return PlannerState(1, (12, 345), state, velocity, run.state_dict())


def test_planner_state_round_trip(tmp_path, memory):
    save_planner_state(tmp_path / "planner.safetensors", memory)
    found = load_planner_state(tmp_path / "planner.safetensors")
    assert (found.index, found.stamp) == (1, (12, 345))
    for name in ("state", "velocity"):
        np.testing.assert_array_equal(getattr(found, name), getattr(memory, name))
    assert found.run.keys() == memory.run.keys()
    for name, array in memory.run.items():
        assert found.run[name].dtype == array.dtype
        np.testing.assert_array_equal(found.run[name], array)


def test_newer_planner_state_replaces_older(tmp_path, memory):
    path = tmp_path / "planner.safetensors"
    save_planner_state(path, memory)
    save_planner_state(path, dataclasses.replace(memory, index=2))
    assert load_planner_state(path).index == 2
    assert list(tmp_path.iterdir()) == [path]


def test_missing_planner_state_is_none(tmp_path):
    assert load_planner_state(tmp_path / "planner.safetensors") is None


@pytest.mark.parametrize(
    ("arrays", "facts", "words"),
    [
        ({"state": np.zeros(4)}, {}, "state is missing, not finite"),
        ({"velocity": np.array([0.0, np.nan, 0.0])}, {}, "velocity is missing, not finite"),
        ({"velocity": None}, {}, "velocity is missing, not finite"),
        ({}, {"stamp": [1, -2]}, "stamp is -2: expected a whole number from 0"),
    ],
)
def test_invalid_planner_state_is_rejected(tmp_path, memory, arrays, facts, words):
    path = tmp_path / "planner.safetensors"
    save_planner_state(path, memory)
    stored, stored_facts = read_arrays(path, "planner")
    changed = {name: array for name, array in {**stored, **arrays}.items() if array is not None}
    write_arrays(path, "planner", changed, {**stored_facts, **facts})
    with pytest.raises(CorruptFileError, match=rf"planner.safetensors: {words}.*delete it"):
        load_planner_state(path)
