"""A run whose nodes are killed, interrupted and restarted at random has the same result as an undisturbed run."""

from concurrent.futures import ThreadPoolExecutor

import pytest

from crashing import EVERYTHING, FREEZE, INTERRUPTION, crash, learn_arguments, outcome
from launching import launch_to_the_end

pytestmark = pytest.mark.ros

# Nodes that a run depends on. experiments/crashes.py also kills monitor and fingerprinter, and more often.
VICTIMS = {"ergodic_planner", "trainer", "pybullet_arm", EVERYTHING, FREEZE, INTERRUPTION}
SEED = 10  # draws these victims first


def _undisturbed(home):
    home.mkdir()
    assert "finished" in launch_to_the_end(home, "learn.launch", *learn_arguments(home))
    return outcome(home / "run")


def test_run_with_killed_nodes_equals_undisturbed_run(tmp_path):
    with ThreadPoolExecutor(1) as beside:
        undisturbed = beside.submit(_undisturbed, tmp_path / "undisturbed")
        crashes = crash(tmp_path, tmp_path / "run", learn_arguments(tmp_path), len(VICTIMS), seed=SEED, timeout=500)
    assert {each.victim for each in crashes} == VICTIMS
    found = outcome(tmp_path / "run")
    for name, content in undisturbed.result().items():
        assert found[name] == content, f"{name} differs after {crashes}"
    for log in tmp_path.glob("launch-*.log"):
        assert "other random draws" not in log.read_text()
