"""Check that a step of the pipeline has finished in a session, and print its result; exit with 1 if it has not."""

import argparse
import sys
from pathlib import Path
from typing import Sequence

from embodied_active_learning.errors import EmbodiedActiveLearningError, SessionError
from embodied_active_learning.objects.decision import Decision
from embodied_active_learning.objects.fingerprint import BLANK
from embodied_active_learning.objects.scoring import SAME_PLACE, TrueObject, Truth, nearest, score
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
    """Check for stored decisions; return what was found where, compared with the true objects."""
    result = load_identification(path, name)
    sessions = dict.fromkeys(decision.session for decision in result.decisions)
    sets = [load_fingerprints(path.parent / session) for session in sessions]
    config = Session.open_read_only(path).config
    truth = true_scene(config, sets)
    scored = score(result.decisions, truth)
    lines = [f"searched {result.images} images of {Path(config.simulation.world).stem}:"]
    lines += [f"  {describe_object(item, result.decisions, truth)}" for item in truth.objects]
    lines += [
        f"found: {scored.hits} of {scored.instances} objects that were learned; false alarms: {scored.false_claims}",
        f"open     {path / 'figures' / 'beliefs.png'}",
        f"results  {identification_folder(path, name)}",
    ]
    return "\n".join(lines)


def describe_object(true_object: TrueObject, decisions: Sequence[Decision], truth: Truth) -> str:
    """Return what was decided about a true object."""
    place = f"{true_object.name:6} at x {true_object.x:.3f} m, y {true_object.y:.3f} m"
    about_objects = [item for item in decisions if item.kind != BLANK]
    of_kind = [item for item in about_objects if truth.kinds[item.session, item.fingerprint] == true_object.kind]
    claims = [item for item in about_objects if item.found and nearest(item.pose, [true_object])[1] <= SAME_PLACE]
    hits = [item for item in claims if item in of_kind]
    if hits:
        error = 100.0 * nearest(hits[0].pose, [true_object])[1]
        return f"{place}: found as {hits[0].fingerprint}, {error:.1f} cm off, confidence {hits[0].confidence:.2f}"
    if claims:
        return f"{place}: FALSE ALARM, taken for {claims[0].fingerprint} (confidence {claims[0].confidence:.2f})"
    if not of_kind:
        return f"{place}: never learned, and rightly not claimed"
    return f"{place}: not found ({of_kind[0].outcome}: {of_kind[0].reason})"


if __name__ == "__main__":
    sys.exit(main())
