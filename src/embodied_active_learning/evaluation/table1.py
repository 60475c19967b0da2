"""The paper's Table 1: fingerprints searched for in their own environments and in new ones.

The paper does not define success. Two rules are scored: "ranked", our reading, takes as many of the best beliefs as
there are objects of a kind; "decided" takes the package's decisions, which do not know the count. An object counts as
found if a place of a fingerprint of its kind lies within 3 cm. A blank is right if no object is within 3 cm.
"""

from __future__ import annotations

from typing import Dict, Iterator, List, Mapping, Sequence, Tuple

from embodied_active_learning.config import BELIEF
from embodied_active_learning.errors import SessionError
from embodied_active_learning.evaluation.result_tables import binomial_interval
from embodied_active_learning.objects.decision import Decision, decisions_about
from embodied_active_learning.objects.fingerprint import BLANK, FingerprintSet
from embodied_active_learning.objects.scoring import TrueObject, Truth, score, true_kinds
from embodied_active_learning.pipeline.api import fingerprint, identify
from embodied_active_learning.session.fingerprints import load_fingerprints
from embodied_active_learning.session.session import Session
from embodied_active_learning.simulation.truth import true_objects

RANKED, DECIDED = "ranked", "decided"
RULES: Dict[str, Dict[str, object]] = {
    RANKED: {"decision": BELIEF, "min_belief": 0.0},
    DECIDED: {"stop_when_decided": False},  # all objects of a kind count, not only the first one found
}
PAPER: Dict[str, Dict[str, Tuple[int, int]]] = {
    "star_plant_duck": {"duck": (18, 20), "plant": (14, 15), "star": (4, 5)},
    "plants_ducks": {"duck": (54, 60), "plant": (28, 30)},
    "stars_ducks": {"duck": (47, 60), "star": (8, 10)},
    "stars_plants": {"plant": (24, 30), "star": (9, 10)},
}
"""Successes and tests of the paper's test environments."""


def ensure_fingerprints(session: Session) -> FingerprintSet:
    """Return the fingerprints of a session, which are collected if there are none yet."""
    try:
        return load_fingerprints(session.paths.path)
    except SessionError:
        return fingerprint(session)


def measure(model: Session, images_of: Session, images: int) -> Iterator[Dict[str, object]]:
    """Yield a row for each rule and kind of object: successes and tests of one model's fingerprints.

    Beliefs treat evidence as the model's configuration states.

    Args:
        model: Session whose fingerprints are searched for.
        images_of: Session of the environment.
        images: Number of images, from the first on; 0 for all.
    """
    objects = true_objects(images_of.config)
    kinds = true_kinds(ensure_fingerprints(model), true_objects(model.config))
    for rule, settings in RULES.items():
        name = f"{model.name[:40]}-{rule}"
        evidence = model.config.identification.evidence
        decisions = identify(model, images_of, images, name, overwrite=True, evidence=evidence, **settings)
        if rule == RANKED:
            decisions = keep_counted(decisions, model.name, kinds, objects)
        for kind in sorted(set(kinds.values()) - {""}):
            hits, tests = successes(decisions, model.name, kinds, kind, objects)
            yield {"rule": rule, "kind": kind, "hits": hits, "tests": tests}


def keep_counted(
    decisions: Sequence[Decision], session: str, kinds: Mapping[str, str], objects: Sequence[TrueObject]
) -> List[Decision]:
    """Return as many of the best beliefs of each fingerprint as there are objects of its kind; one of a blank."""
    kept: List[Decision] = []
    for name, kind in kinds.items():
        about = sorted(decisions_about(decisions, session, name), key=lambda item: -item.belief_mean)
        kept += about[: 1 if kind == BLANK else sum(item.kind == kind for item in objects)]
    return kept


def successes(
    decisions: Sequence[Decision], session: str, kinds: Mapping[str, str], kind: str, objects: Sequence[TrueObject]
) -> Tuple[int, int]:
    """Return successes and tests of the fingerprints of a kind: all its objects for each of them.

    Args:
        decisions: Decisions about all fingerprints of the session.
        session: Name of the session.
        kinds: True kind of each fingerprint.
        kind: Kind to count.
        objects: True objects of the environment.
    """
    names = [name for name, other in kinds.items() if other == kind]
    truth = Truth(objects, {(session, name): kind for name in names})
    if kind == BLANK:
        about = [decisions_about(decisions, session, name) for name in names]
        right = [any(item.found and not truth.is_false_claim(item) for item in items) for items in about]
        return sum(right), len(names)
    found = score(decisions, truth)
    return found.hits, found.instances


def table_lines(rows: Sequence[Mapping[str, str]]) -> List[List[str]]:
    """Return the cells of Table 1: a line for each environment, columns for kinds, and totals, as "hits/tests".

    Blanks count in a model's own environment only, as in the paper. Totals have exact 95 % intervals of a binomial
    distribution, as if tests with one model were independent.
    """
    rows = [row for row in rows if row["kind"] != BLANK or row["environment"] not in PAPER]
    kinds = sorted({row["kind"] for row in rows})
    own = sorted({row["environment"] for row in rows} - set(PAPER))
    new = [name for name in PAPER if any(row["environment"] == name for row in rows)]
    lines = []
    for environment in [*own, *new, "total"]:
        chosen = [row for row in rows if environment in (row["environment"], "total")]
        cells = [_fraction([row for row in chosen if row["kind"] == kind]) for kind in kinds]
        lines.append([environment, *cells, _fraction(chosen, percent=True), _paper(environment)])
    return [["environment", *kinds, "total", "paper"], *lines]


def _fraction(rows: Sequence[Mapping[str, str]], percent: bool = False) -> str:
    hits, tests = (sum(int(row[name]) for row in rows) for name in ("hits", "tests"))
    if not percent or not tests:
        return f"{hits}/{tests}"
    low, high = binomial_interval(hits, tests)
    return f"{hits}/{tests} ({100.0 * hits / tests:.0f} %, {100.0 * low:.0f}-{100.0 * high:.0f})"


def _paper(environment: str) -> str:
    if environment not in PAPER:
        return "-"
    hits, tests = (sum(pair[part] for pair in PAPER[environment].values()) for part in (0, 1))
    return f"{hits}/{tests} ({100.0 * hits / tests:.0f} %)"
