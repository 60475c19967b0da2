"""A run whose nodes are killed, interrupted and started again at random ends as if nothing had happened to it."""

from concurrent.futures import ThreadPoolExecutor

from crashing import EVERYTHING, INTERRUPTION, crash, learn_arguments, outcome
from launching import launch_to_the_end

# What a run depends on. experiments/crashes.py kills monitor and fingerprinter, too, and as often as it is asked to.
VICTIMS = {"ergodic_planner", "trainer", "pybullet_arm", EVERYTHING, INTERRUPTION}
SEED = 126  # draws these first


def _undisturbed(home):
    home.mkdir()
    assert "finished" in launch_to_the_end(home, "learn.launch", *learn_arguments(home))
    return outcome(home / "run")


def test_a_run_that_is_killed_again_and_again_ends_like_one_that_was_left_alone(tmp_path):
    with ThreadPoolExecutor(1) as beside:
        undisturbed = beside.submit(_undisturbed, tmp_path / "undisturbed")
        crashes = crash(tmp_path, tmp_path / "run", learn_arguments(tmp_path), len(VICTIMS), seed=SEED, timeout=500)
    assert {each.victim for each in crashes} == VICTIMS
    found = outcome(tmp_path / "run")
    for name, content in undisturbed.result().items():
        assert found[name] == content, f"{name} differs after {crashes}"
    for log in tmp_path.glob("launch-*.log"):
        assert "other random draws" not in log.read_text()
