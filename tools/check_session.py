"""Exits 0 if a part of the pipeline has finished in a session, else 1 and says so: what a run's exit status stands on.

check_session.py learned FOLDER | fingerprinted FOLDER | identified FOLDER NAME
"""

import sys
from pathlib import Path
from typing import List

from embodied_active_learning.errors import EmbodiedActiveLearningError, SessionError
from embodied_active_learning.objects.report import decision_table, score
from embodied_active_learning.session.fingerprints import load_fingerprints
from embodied_active_learning.session.identifications import identification_folder, load_identification
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.summary import read_summary
from embodied_active_learning.simulation.truth import true_scene


def main(part: str, path: Path, names: List[str]) -> int:
    """Say how the part ended -> exit status."""
    try:
        sys.stdout.write(f"{CHECKS[part](path, *names)}\n")
    except EmbodiedActiveLearningError as error:
        sys.stderr.write(f"FAILED: {error}\n")
        return 1
    return 0


def learned(path: Path) -> str:
    """Whether the run has written its summary."""
    session = Session.open_read_only(path)
    if not read_summary(session.paths.summary).finished:
        raise SessionError(f"{path} did not finish")
    return f"learned: {path}"


def fingerprinted(path: Path) -> str:
    """Whether fingerprints are stored."""
    found = load_fingerprints(path)
    return f"fingerprinted: {', '.join(item.name for item in found.fingerprints)}"


def identified(path: Path, name: str) -> str:
    """Whether decisions are stored -> them beside the truth."""
    result = load_identification(path, name)
    sessions = dict.fromkeys(decision.session for decision in result.decisions)
    sets = [load_fingerprints(path.parent / session) for session in sessions]
    truth = true_scene(Session.open_read_only(path).config, sets)
    scored = score(result.decisions, truth)
    return (
        f"\n{decision_table(result.decisions, truth)}\n\n"
        f"{scored.hits} of {scored.instances} known objects found, {scored.false_claims} false claims, "
        f"{result.images} images\n"
        f"  beliefs  {path / 'figures' / 'beliefs.png'}\n"
        f"  results  {identification_folder(path, name)}"
    )


CHECKS = {"learned": learned, "fingerprinted": fingerprinted, "identified": identified}

if __name__ == "__main__":
    sys.exit(main(sys.argv[1], Path(sys.argv[2]), sys.argv[3:]))
