"""Exits 0 if the session at a path has finished, else 1 and says so: what the exit status of a run stands on."""

import sys
from pathlib import Path

from embodied_active_learning.errors import EmbodiedActiveLearningError
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.summary import read_summary


def main(path: Path) -> int:
    """Say how the run ended -> exit status."""
    try:
        session = Session.open_read_only(path)
        finished = read_summary(session.paths.summary).finished
    except EmbodiedActiveLearningError as error:
        sys.stderr.write(f"FAILED: {error}\n")
        return 1
    if not finished:
        sys.stderr.write(f"FAILED: {path} did not finish\n")
        return 1
    sys.stdout.write(f"done: {path}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
