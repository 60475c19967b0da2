"""The figures and tables of docs/identification.md, from the CSV files in experiments/results/identification/."""

from __future__ import annotations

from pathlib import Path
from typing import Mapping, Optional

from embodied_active_learning.evaluation.identification_tables import (
    Outcome,
    Share,
    group_by,
    of_objects,
    outcome,
    outcome_table,
)
from embodied_active_learning.evaluation.result_tables import Rows, replace_block
from embodied_active_learning.figures.shares import Interval, draw_shares
from embodied_active_learning.sweep.csv_files import read_rows

EXPERIMENTS = Path(__file__).resolve().parent
RESULTS, PAGE = EXPERIMENTS / "results" / "identification", EXPERIMENTS.parent / "docs" / "identification.md"
IMAGES = PAGE.parent / "images" / "results"
AIMS = {"hits": 0.95, "false claims of absent kinds": 0.01}
RESERVED = {
    "": "first set, scenes 0 and 1, version 1",
    "_2": "first set, scenes 2 to 6, version 2",
    "_3": "second set, scenes 0 to 4, version 3",
    "_4": "second set, scenes 5 to 9, version 4",
    "_5": "second set, scenes 10 to 14, version 5",
    "_6": "third set, scenes 15 to 24, version 6 (present)",
    "_7": "third set, scenes 25 to 29, version 6 (present)",
}
"""Evaluations on reserved objects and tables, by the end of their file's name."""
RESERVED_LIMITS = {"reserved_7": "without random differences (used)", "reserved_7_differences": "with them"}
"""Simulated places for the miss limit, in the same scenes, by file."""
RESERVED_LENGTHS = {"reserved_6_300": "after 300 steps", "reserved_6": "after 1000 steps"}
"""Evaluations of the models of the third set of reserved worlds in the same scenes, by file."""
MODEL_LENGTHS = {
    "at_stop": "by the criterion (214 to 314 steps)",
    "after_300": "after 300 steps",
    "after_1000": "after 1000 steps",
    "after_3000": "after 3000 steps",
}
"""Evaluations of the models of four worlds, by file."""
ERROR_RATES = {
    "verified, error rate 0.025": 0.025,
    "verified": 0.05,
    "verified, error rate 0.1": 0.1,
    "verified, error rate 0.2": 0.2,
}
"""Accepted error rate by rule."""


def draw_identification() -> None:
    """Draw the shares of hits and false claims, and list all outcomes."""
    reserved = [row for evaluation in RESERVED for row in verified(f"reserved{evaluation}")]
    conditions = {**group_by(reserved, "condition"), "all conditions": reserved}
    replace_block(PAGE, "reserved", outcome_table("condition", conditions))
    draw_outcomes("identification_reserved", conditions)
    evaluations = {text: verified(f"reserved{name}") for name, text in RESERVED.items()}
    replace_block(PAGE, "reserved_evaluations", outcome_table("evaluation", evaluations))
    lengths = {text: verified(name) for name, text in RESERVED_LENGTHS.items()}
    replace_block(PAGE, "reserved_lengths", outcome_table("learning ended", lengths))
    limits = {text: verified(name) for name, text in RESERVED_LIMITS.items()}
    replace_block(PAGE, "reserved_limits", outcome_table("simulated places for the miss limit", limits))
    by_rule = group_by(identification_rows("learned"), "rule")
    rules = dict(sorted(by_rule.items(), key=lambda item: -hit_share(outcome(item[1]))))
    replace_block(PAGE, "rules", outcome_table("rule", rules))
    draw_outcomes("identification_rules", rules)
    development = verified("development_2")
    shipped, random = ([row for row in development if is_shipped(row) == value] for value in (True, False))
    groups = {"shipped objects": shipped, "objects of random worlds": random}
    replace_block(PAGE, "development", outcome_table("models", groups))
    lengths = {text: verified(name) for name, text in MODEL_LENGTHS.items()}
    replace_block(PAGE, "model_lengths", outcome_table("learning ended", lengths))
    rates = [row for row in identification_rows("error_rates") if row["rule"] in ERROR_RATES]
    of_rates = {
        f"{ERROR_RATES[rule]}, {name}": [row for row in rows if is_shipped(row) == shipped_ones]
        for name, shipped_ones in (("shipped", True), ("random", False))
        for rule, rows in sorted(group_by(rates, "rule").items(), key=lambda item: ERROR_RATES[item[0]])
    }
    replace_block(PAGE, "error_rates", outcome_table("error rate, objects", of_rates))


def identification_rows(name: str) -> Rows:
    """Return the rows about objects of an evaluation."""
    return of_objects(read_rows(RESULTS / f"{name}.csv"))


def verified(name: str) -> Rows:
    """Return the rows of the package's decision."""
    return [row for row in identification_rows(name) if row["rule"] == "verified"]


def is_shipped(row: Mapping[str, str]) -> bool:
    """Return whether a row is about a model of a shipped world."""
    return row["session"].startswith("ergodic-")


def hit_share(item: Outcome) -> float:
    """Return the share of present objects that are found."""
    return item.hits.count / item.hits.total if item.hits else 0.0


def draw_outcomes(name: str, groups: Mapping[str, Rows]) -> None:
    """Draw hits and false claims of each group, with the aims."""
    outcomes = {group: outcome(rows) for group, rows in groups.items()}
    panels = {
        "hits": {group: interval_of(item.hits) for group, item in outcomes.items()},
        "false claims of absent kinds": {group: interval_of(item.false_claims) for group, item in outcomes.items()},
    }
    draw_shares(IMAGES / f"{name}.png", panels, AIMS)


def interval_of(share: Optional[Share]) -> Optional[Interval]:
    """Return the share and its interval."""
    return (share.count / share.total, share.low, share.high) if share else None
