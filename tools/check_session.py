"""Check that a step of the pipeline has finished in a session, and print its result; exit with 1 if it has not."""

import argparse
import sys
from pathlib import Path

from embodied_active_learning.errors import EmbodiedActiveLearningError, SessionError
from embodied_active_learning.objects.report import score
from embodied_active_learning.session.fingerprints import load_fingerprints
from embodied_active_learning.session.identifications import identification_folder, load_identification
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.summary import read_summary
from embodied_active_learning.simulation.truth import true_scene


def main() -> int:
    """Print the result of a step. Return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("step", choices=("learned", "fingerprinted", "identified"))
    parser.add_argument("session", type=Path, help="folder of the session")
    parser.add_argument("name", nargs="?", default="", help="name of the identification, for the step identified")
    options = parser.parse_args()
    if (options.step == "identified") != bool(options.name):
        parser.error("give the name of the identification with the step identified, and only there")
    try:
        sys.stdout.write(f"{check(options.step, options.session, options.name)}\n")
    except EmbodiedActiveLearningError as error:
        sys.stderr.write(f"FAILED: {error}\n")
        return 1
    return 0


def check(step: str, path: Path, name: str) -> str:
    """Return the result of a step as text. Raises SessionError if it has not finished."""
    if step == "learned":
        return learned(path)
    if step == "fingerprinted":
        return fingerprinted(path)
    return identified(path, name)


def learned(path: Path) -> str:
    """Check for a summary of a finished run."""
    session = Session.open_read_only(path)
    if not read_summary(session.paths.summary).finished:
        raise SessionError(f"{path} has not finished: resume the run with resume:=true")
    return f"learned: {path}"


def fingerprinted(path: Path) -> str:
    """Check for stored fingerprints."""
    found = load_fingerprints(path)
    return f"fingerprinted: {', '.join(item.name for item in found.fingerprints)}"


def identified(path: Path, name: str) -> str:
    """Check for stored decisions; return their score. The identifier has logged the decisions."""
    result = load_identification(path, name)
    sessions = dict.fromkeys(decision.session for decision in result.decisions)
    sets = [load_fingerprints(path.parent / session) for session in sessions]
    truth = true_scene(Session.open_read_only(path).config, sets)
    scored = score(result.decisions, truth)
    return (
        f"{scored.hits} of {scored.instances} objects found, {scored.false_claims} false claims, "
        f"{result.images} images\n"
        f"  beliefs  {path / 'figures' / 'beliefs.png'}\n"
        f"  results  {identification_folder(path, name)}"
    )


if __name__ == "__main__":
    sys.exit(main())
