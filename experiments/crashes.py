#!/usr/bin/env python3
"""Kill nodes of a learning run at random, and compare its results with those of an undisturbed run.

    python3 experiments/crashes.py --kills 50 --steps 250 --seed 1

Exits 0 if the tables and the final model equal those of the undisturbed run byte for byte.
"""

import argparse
import collections
import sys
import tempfile
import time
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1] / "test"
sys.path[:0] = [str(TESTS), str(TESTS / "support")]

from crashing import crash, learn_arguments, outcome  # noqa: E402  shared with the tests
from launching import launch_to_the_end  # noqa: E402


def log(text: str) -> None:
    """Print without buffering."""
    print(text, flush=True)


def main() -> int:
    """Run undisturbed, run with kills, and compare; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--steps", type=int, default=250, help="exploration steps of the run")
    parser.add_argument("--seed", type=int, default=1, help="seed of victims and times")
    parser.add_argument("--timeout", type=float, default=3600.0, help="time limit of the run with kills, s")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        undisturbed, killed = Path(folder) / "undisturbed", Path(folder) / "killed"
        undisturbed.mkdir()
        killed.mkdir()
        log("undisturbed run")
        arguments = learn_arguments(undisturbed, steps=options.steps)
        launch_to_the_end(undisturbed, "learn.launch", *arguments, timeout=options.timeout)
        expected = outcome(undisturbed / "run")
        began = time.monotonic()
        arguments = learn_arguments(killed, steps=options.steps)
        crashes = crash(killed, killed / "run", arguments, options.kills, options.seed, options.timeout, log)
        found = outcome(killed / "run")
    counts = collections.Counter(each.victim for each in crashes)
    print(f"{len(crashes)} kills in {time.monotonic() - began:.0f} s: {dict(counts)}")
    different = [name for name, content in expected.items() if found[name] != content]
    print(f"different from the undisturbed run: {', '.join(different) or 'nothing'}")
    return 1 if different or len(crashes) < options.kills else 0


if __name__ == "__main__":
    sys.exit(main())
