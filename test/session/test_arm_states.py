"""The states of a simulated arm: kept by stamp, written to the session and read back bit for bit."""

import numpy as np
import pytest

from embodied_active_learning.errors import CommandError, CorruptFileError
from embodied_active_learning.session.arm_states import KEPT, ArmStates
from embodied_active_learning.session.array_files import read_arrays, write_arrays


def state(number):
    return {"steps": np.array([float(number)]), "joints": np.arange(7.0) / (number + 1)}


@pytest.fixture
def path(tmp_path):
    return tmp_path / "run" / "arm_states.safetensors"


def written(path, count):
    path.parent.mkdir()
    states = ArmStates(path)
    for number in range(count):
        states.add((number, 7), state(number))
    states.write()


def loaded(path):
    states = ArmStates(path)
    states.load()
    return states


def test_states_are_read_back_bit_for_bit(path):
    written(path, 3)
    states = loaded(path)
    assert states.stamps == [(0, 7), (1, 7), (2, 7)]
    for name, array in state(2).items():
        np.testing.assert_array_equal(states.at((2, 7))[name], array)


def test_only_the_newest_states_are_kept(path):
    written(path, KEPT + 5)
    assert loaded(path).stamps == [(number, 7) for number in range(5, KEPT + 5)]


def test_unknown_stamp_is_rejected(path):
    with pytest.raises(CommandError, match=r"no saved arm state for the time 3\.000000000 s"):
        loaded(path).at((3, 0))


def test_newer_state_replaces_one_of_the_same_stamp(path):
    states = ArmStates(path)
    states.add((1, 0), state(1))
    states.add((2, 0), state(2))
    states.add((1, 0), state(5))
    assert states.stamps == [(2, 0), (1, 0)]
    assert states.at((1, 0))["steps"] == 5.0


def test_nothing_is_written_without_a_session_folder(path):
    states = ArmStates(path)
    states.add((1, 0), state(1))
    states.write()
    assert not path.parent.exists()


@pytest.mark.parametrize(
    "changed",
    [
        {"joints": np.zeros((2, 7))},
        {"joints": np.zeros((3, 7), np.float32)},
        {"stamps": np.zeros((KEPT + 1, 2), np.int64)},
    ],
)
def test_malformed_file_is_rejected(path, changed):
    written(path, 3)
    arrays, facts = read_arrays(path, "arm_states")
    write_arrays(path, "arm_states", {**arrays, **changed}, facts)
    with pytest.raises(CorruptFileError, match=r"arm_states\.safetensors: .*delete it"):
        loaded(path)
