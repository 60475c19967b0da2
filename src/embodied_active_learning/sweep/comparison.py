"""Statistics over the seeds of runs: means and bootstrap intervals of all columns of their tables.

Runs of one seed in several worlds are not independent: explorers that do not use the model move alike in all of them.
They are averaged first, and seeds are resampled.
"""

from __future__ import annotations

from pathlib import Path
from typing import Dict, Iterator, List, Mapping, NamedTuple, Sequence, Tuple

import numpy as np

from embodied_active_learning.config import SIMULATED, Config
from embodied_active_learning.errors import ConfigError, SessionError
from embodied_active_learning.figures.curves import Curve
from embodied_active_learning.schema import settings, suggestion
from embodied_active_learning.session.tables import COLUMNS, UNITS
from embodied_active_learning.sweep.run_records import RECORD_FILE, Record, load_record

POINTS = 50
"""Positions of the common axis that runs are interpolated to."""
RESAMPLES = 2000
LEVEL = 0.95
_NOT_COMPARED = ("time", "x", "y", "theta", "observations")
_NOT_CLUSTERING = ("views", "view_std", "view_yaw_std", "view_box", "steps_per_view", "min_view_distance",
                   "min_view_turn", "trials")  # fmt: skip
"""Settings of section fingerprint that matter only after clustering."""
_SEED = 0


class Mean(NamedTuple):
    """Means over seeds and the ends of their bootstrap intervals, (N,) each; the interval of one seed is NaN."""

    mean: np.ndarray
    low: np.ndarray
    high: np.ndarray


def bootstrap_mean(values: np.ndarray, seeds: Sequence[object]) -> Mean:
    """Return the mean over seeds, of the mean over the runs of each, with percentile bootstrap intervals.

    Args:
        values: (R, N) one row per run, without NaN.
        seeds: The seed of each of the R runs.
    """
    values, names = np.asarray(values, dtype=float), list(dict.fromkeys(seeds))
    means = np.array([values[[seed == name for seed in seeds]].mean(axis=0) for name in names])
    if len(means) == 1:
        unknown = np.full(values.shape[1], np.nan)
        return Mean(means[0], unknown, unknown)
    chosen = np.random.default_rng(_SEED).integers(len(means), size=(RESAMPLES, len(means)))
    resampled = means[chosen].mean(axis=1)
    low, high = np.quantile(resampled, [(1.0 - LEVEL) / 2.0, (1.0 + LEVEL) / 2.0], axis=0)
    return Mean(means.mean(axis=0), low, high)


def load_records(folders: Sequence[Path]) -> List[Record]:
    """Return the records of folders: sessions, records, or folders of records. Raises SessionError if one has none."""
    records = []
    for folder in folders:
        if not Path(folder).exists():
            raise SessionError(
                f"there is no {folder}: give the folder of a session, such as {Config().session.root}/NAME"
            )
        inside = sorted(path.parent for path in Path(folder).glob(f"*/{RECORD_FILE}"))
        records += [load_record(path) for path in inside or [Path(folder)]]
    if not records:
        raise SessionError("no run to compare: give sessions, or folders of records")
    return records


def group_records(records: Sequence[Record], key: str) -> Dict[str, List[Record]]:
    """Group records by a setting (`section/key`) or by "variant", in the order of their first member.

    Raises:
        ConfigError: There is no such setting; records do not contain section `session`.
    """
    names = ["variant", *(f"{section}/{item.name}" for section, item in settings(Config) if section != "session")]
    if key not in names:
        raise ConfigError(f"runs cannot be grouped by {key}: {suggestion(key, names)}")
    groups: Dict[str, List[Record]] = {}
    for record in records:
        section, _, name = key.partition("/")
        value = record.variant if key == "variant" else record.config.portable()[section][name]
        groups.setdefault(str(value), []).append(record)
    return groups


def seed_of(record: Record) -> object:
    """Return what a run has in common with those that it depends on: its seed, or of a real arm's run only its name."""
    return record.config.exploration.seed if record.config.arm.robot == SIMULATED else record.name


def clustering_settings(records: Sequence[Record]) -> str:
    """Return a sentence with each clustering setting that differs from the default or among runs, or nothing."""
    sections = [record.config.to_dict()["fingerprint"] for record in records]
    parts = []
    for key, default in Config().to_dict()["fingerprint"].items():
        values = [str(section[key]) for section in sections]
        if set(values) - {str(default)} and key not in _NOT_CLUSTERING:
            runs = ", ".join(
                f"{value} ({values.count(value)} of {len(values)} runs)" for value in dict.fromkeys(values)
            )
            parts.append(f"`fingerprint/{key}` {runs if len(set(values)) > 1 else values[0]} (default {default})")
    return f"Objects were clustered with {', '.join(parts)}." if parts else ""


def compare_columns(groups: Mapping[str, Sequence[Record]]) -> Dict[Tuple[str, str], List[Curve]]:
    """Return the curves of all groups by (table, column). Runs of a column are cut to the shortest of their group."""
    curves: Dict[Tuple[str, str], List[Curve]] = {}
    for table, columns in COLUMNS.items():
        for column in columns[1:]:
            if column not in _NOT_COMPARED:
                found = [_curve(name, records, table, column) for name, records in groups.items()]
                curves[table, column] = [curve for curve in found if len(curve.x)]
    return {key: found for key, found in curves.items() if found}


def with_unit(column: str) -> str:
    """Return the name of a column as the label of an axis, with its unit on a second line if it has one."""
    return f"{column}\n[{UNITS[column]}]" if column in UNITS else column


def comparison_rows(curves: Mapping[Tuple[str, str], Sequence[Curve]]) -> Iterator[Dict[str, object]]:
    """Yield the numbers of all curves as rows of a table."""
    for (table, column), found in curves.items():
        for curve in found:
            for x, mean, low, high in zip(curve.x, curve.mean, curve.low, curve.high):
                place = {"table": table, "column": column, "group": curve.label}
                yield {**place, "at": x, "mean": mean, "low": low, "high": high}


def _curve(name: str, records: Sequence[Record], table: str, column: str) -> Curve:
    """Return the mean of a column over the seeds of a group, on a common axis; n is the number of seeds."""
    found = [_finite(record.tables[table], COLUMNS[table][0], column) for record in records]
    series = [(x, y) for x, y in found if len(x)]
    seeds = [seed_of(record) for record, (x, _) in zip(records, found) if len(x)]
    label = f"{name} (n = {len(set(seeds))})"
    start, end = max((x[0] for x, _ in series), default=1.0), min((x[-1] for x, _ in series), default=0.0)
    if start > end:  # a run ended before another one had its first row
        empty = np.empty(0)
        return Curve(label, empty, empty, empty, empty)
    axis = np.linspace(start, end, POINTS)
    return Curve(label, axis, *bootstrap_mean(np.array([np.interp(axis, x, y) for x, y in series]), seeds))


def _finite(table: Mapping[str, np.ndarray], axis: str, column: str) -> Tuple[np.ndarray, np.ndarray]:
    valid = np.isfinite(table[column])
    return table[axis][valid], table[column][valid]
