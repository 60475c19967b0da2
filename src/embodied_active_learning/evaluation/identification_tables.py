"""Tables about identification: hits, false claims, and undecided searches, with 95 % intervals.

A row states how one fingerprint fared in one scene under one rule (`Row` of experiments/identification_scenes.py). An
object that is present is a hit if the fingerprint is found within 3 cm of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, List, Mapping, Optional, Tuple

import numpy as np

from embodied_active_learning.evaluation.result_tables import Rows, binomial_interval, markdown
from embodied_active_learning.objects.fingerprint import BLANK

ALL = "all"
"""Condition with all changes together."""
OTHER_TABLE = ("other table", ALL)
"""Conditions with a table that no session learned."""
NO_OBJECT = "?"
"""Kind of a fingerprint at whose centre no object stands."""
HEADER = ("hits (95 % interval)", "undecided", "wrong places", "false claims of absent kinds", "undecided, absent",
          "error [cm]")  # fmt: skip
_RESAMPLES = 2000


@dataclass(frozen=True)
class Share:
    """How often something happened, with a 95 % interval of its probability."""

    count: int
    total: int
    low: float
    high: float

    def __str__(self) -> str:
        """Return "count / total (low-high %)"."""
        return f"{self.count} / {self.total} ({100.0 * self.low:.0f}-{100.0 * self.high:.0f} %)"


@dataclass(frozen=True)
class Outcome:
    """How a group of searches ended.

    Attributes:
        hits: Present objects that are found; None without any.
        undecided: Present objects that are undecided.
        wrong_places: Fingerprints found where their object does not stand, although it is present.
        false_claims: Fingerprints found although their kind is absent.
        undecided_absent: Fingerprints that are undecided, and whose kind is absent.
        error: Median distance of hits, in metres; None without hits.
    """

    hits: Optional[Share]
    undecided: Optional[Share]
    wrong_places: Optional[Share]
    false_claims: Optional[Share]
    undecided_absent: Optional[Share]
    error: Optional[float]

    def cells(self) -> List[str]:
        """Return the cells of a table with `HEADER`."""
        hits, _, _, claims, _ = shares = (
            self.hits, self.undecided, self.wrong_places, self.false_claims, self.undecided_absent,
        )  # fmt: skip
        counts = ["-" if item is None else f"{item.count} / {item.total}" for item in shares]
        counts[0], counts[3] = ("-" if item is None else str(item) for item in (hits, claims))
        return [*counts, "-" if self.error is None else f"{100.0 * self.error:.2f}"]


def outcome(rows: Rows) -> Outcome:
    """Summarise rows.

    In conditions with a learned table, an object counts as present only for the session that learned this table.
    Several fingerprints of one kind and session count once where the kind is present, because only the most similar one
    is found at a place; wrong places are counted for each.
    """
    present = [row for row in rows if row["present"] == "1"]
    absent = [row for row in rows if row["present"] == "0"]
    searched = _one_of_a_kind([row for row in present if _has_fair_table(row)])
    errors = [float(row["error"]) for row in searched if row["hit"] == "1" and row["kind"] != BLANK]
    return Outcome(
        hits=share(searched, "hit"),
        undecided=share(searched, "undecided"),
        wrong_places=share(present, "false_claim"),
        false_claims=share(absent, "false_claim"),
        undecided_absent=share(absent, "undecided"),
        error=float(np.median(errors)) if errors else None,
    )


def of_objects(rows: Rows) -> List[Mapping[str, str]]:
    """Return the rows about fingerprints of objects."""
    return [row for row in rows if row["kind"] not in (BLANK, NO_OBJECT)]


def outcome_table(column: str, groups: Mapping[str, Rows]) -> List[str]:
    """Return a Markdown table with a line for each group that has rows."""
    lines = [[name, *outcome(rows).cells()] for name, rows in groups.items() if rows]
    return markdown((column, *HEADER), lines)


def group_by(rows: Rows, column: str) -> Dict[str, List[Mapping[str, str]]]:
    """Return the rows of each value of a column, in the order in which the values appear."""
    groups: Dict[str, List[Mapping[str, str]]] = {}
    for row in rows:
        groups.setdefault(row[column], []).append(row)
    return groups


def share(rows: Rows, field: str) -> Optional[Share]:
    """Return how many rows have a field set; None without rows.

    The interval is a bootstrap over sessions; where that has no width, because the share is the same in all sessions
    or there is a single session, it is the exact one of independent rows.
    """
    if not rows:
        return None
    sessions = group_by(rows, "session").values()
    counts = np.array([[sum(int(row[field]) for row in part), len(part)] for part in sessions])
    count, total = (int(value) for value in counts.sum(axis=0))
    drawn = counts[np.random.default_rng(0).integers(len(counts), size=(_RESAMPLES, len(counts)))].sum(axis=1)
    low, high = np.quantile(drawn[:, 0] / drawn[:, 1], (0.025, 0.975))
    if low == high:
        low, high = binomial_interval(count, total)
    return Share(count, total, float(low), float(high))


def _one_of_a_kind(rows: Rows) -> List[Mapping[str, str]]:
    """Return one row of each kind that is present in a scene for a session: a hit if there is one, else undecided."""
    best: Dict[Tuple[str, ...], Mapping[str, str]] = {}
    for row in rows:
        key = tuple(row[name] for name in ("condition", "scene", "session", "kind"))
        if key not in best or (row["hit"], row["undecided"]) > (best[key]["hit"], best[key]["undecided"]):
            best[key] = row
    return list(best.values())


def _has_fair_table(row: Mapping[str, str]) -> bool:
    return row["condition"] in OTHER_TABLE or row["own_table"] == "1" or row["kind"] == BLANK
