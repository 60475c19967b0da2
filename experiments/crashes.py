#!/usr/bin/env python3
"""Kill the nodes of a learning run at random, as often as asked for, and compare its results with an undisturbed run's.

    python3 experiments/crashes.py --kills 50 --steps 250 --seed 1

Ends with 0 when the tables and the final model are byte for byte those of a run that nothing happened to.
"""

import argparse
import collections
import sys
import tempfile
import time
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1] / "test"
sys.path[:0] = [str(TESTS), str(TESTS / "faults")]

from crashing import crash, learn_arguments, outcome  # noqa: E402  lies with the tests, which use it too
from launching import launch_to_the_end  # noqa: E402


def say(text: str) -> None:
    """Tell at once, also where the output goes to a file."""
    print(text, flush=True)


def main() -> int:
    """Run twice, kill once, compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--steps", type=int, default=250, help="exploration steps of the run")
    parser.add_argument("--seed", type=int, default=1, help="of what is killed, and when")
    parser.add_argument("--timeout", type=float, default=3600.0, help="seconds for the run that is killed")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        whole, killed = Path(folder) / "whole", Path(folder) / "killed"
        whole.mkdir()
        killed.mkdir()
        say("a run that nothing happens to")
        launch_to_the_end(whole, "learn.launch", *learn_arguments(whole, steps=options.steps), timeout=options.timeout)
        expected = outcome(whole / "run")
        began = time.monotonic()
        arguments = learn_arguments(killed, steps=options.steps)
        crashes = crash(killed, killed / "run", arguments, options.kills, options.seed, options.timeout, say)
        found = outcome(killed / "run")
    counts = collections.Counter(each.victim for each in crashes)
    print(f"{len(crashes)} kills in {time.monotonic() - began:.0f} s: {dict(counts)}")
    different = [name for name, content in expected.items() if found[name] != content]
    print(f"different from the undisturbed run: {', '.join(different) or 'nothing'}")
    return 1 if different or len(crashes) < options.kills else 0


if __name__ == "__main__":
    sys.exit(main())
