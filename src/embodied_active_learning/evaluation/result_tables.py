"""Tables and curves of the experiments' results, as Markdown lines and as data for figures."""

from __future__ import annotations

from pathlib import Path
from typing import Callable, Iterable, List, Mapping, Optional, Sequence, Tuple

import numpy as np
from scipy.stats import beta

from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.figures.curves import Curve
from embodied_active_learning.files import FileReader
from embodied_active_learning.objects.fingerprint import BLANK
from embodied_active_learning.session.atomic import write_text
from embodied_active_learning.session.tables import COLUMNS
from embodied_active_learning.sweep.comparison import bootstrap_mean, seed_of
from embodied_active_learning.sweep.run_records import Record

_READER = FileReader(CorruptFileError, "restore it")
_LAST_STEPS = 50
"""Steps that the ergodic measure at the end of a run is averaged over."""
_SHORTEST_END = 0.1
"""Share of a run at its end in which a value must stay below a limit."""
Rows = Sequence[Mapping[str, str]]
Measure = Callable[[Record], Optional[float]]
"""A number of a run; None if it has none."""


def markdown(header: Sequence[str], rows: Iterable[Sequence[object]]) -> List[str]:
    """Return the lines of a Markdown table; floats get three digits."""
    lines = [f"| {' | '.join(header)} |", "|" + " --- |" * len(header)]
    return [*lines, *(f"| {' | '.join(_text(value) for value in row)} |" for row in rows)]


def folded(summary: str, lines: Sequence[str]) -> List[str]:
    """Return Markdown lines that a reader unfolds by a click on the summary."""
    return ["<details>", f"<summary>{summary}</summary>", "", *lines, "", "</details>"]


def run_table(records: Sequence[Record]) -> List[str]:
    """Return a table with a line for each run."""
    header = (
        "variant", "world", "seed", "steps", "ergodic measure [nat]", "coverage", "active units",
        "error own / shuffled / none", "distance [m]", "object clusters, error [cm]", "wall time [min]",
    )  # fmt: skip
    return markdown(header, [_run_row(record) for record in records])


def group_table(groups: Mapping[str, Sequence[Record]], measures: Mapping[str, Measure]) -> List[str]:
    """Return a table of means with 95 % intervals over seeds: a line for each group, a column for each measure."""
    rows = []
    for name, records in groups.items():
        cells: List[object] = [name, len(records)]
        for measure in measures.values():
            found = [(value, seed_of(record)) for record in records if (value := measure(record)) is not None]
            reached = f"; {len(found)} of {len(records)} runs" if 0 < len(found) < len(records) else ""
            cells.append(interval([value for value, _ in found], [seed for _, seed in found]) + reached)
        rows.append(cells)
    return markdown(("group", "runs", *measures), rows)


def summary_value(name: str) -> Measure:
    """Return the measure that is a field of the summary."""
    return lambda record: getattr(record.summary, name)


def last_value(table: str, column: str) -> Measure:
    """Return the measure that is the last value of a column; None without one, such as the effort of pose commands."""

    def find(record: Record) -> Optional[float]:
        values = record.tables[table][column]
        return float(values[-1]) if len(values) and np.isfinite(values[-1]) else None

    return find


def stays_below(table: str, column: str, limit: float) -> Measure:
    """Return the measure that is the first step or update from which all values are below a limit.

    None if that is so in less than the last tenth of the run: a value that fluctuates may end there by chance.
    """

    def find(record: Record) -> Optional[float]:
        axis = record.tables[table][COLUMNS[table][0]]
        others = np.flatnonzero(~(record.tables[table][column] < limit))
        rest = axis[others[-1] + 1 if len(others) else 0 :]
        return float(rest[0]) if len(rest) and rest[0] <= (1.0 - _SHORTEST_END) * axis[-1] else None

    return find


def final_ergodic_measure(record: Record) -> Optional[float]:
    """Return the mean of the ergodic measure over the rows of the last 50 steps; None without one.

    A record holds at most 300 rows, so that these are every tenth of 3000 steps.
    """
    table = record.tables["exploration"]
    late = table["ergodic_measure"][table["step"] > record.summary.steps - _LAST_STEPS]
    return float(np.mean(late)) if len(late) else None


def interval(values: Sequence[float], seeds: Sequence[object]) -> str:
    """Return "mean (low to high)" with a bootstrap interval over seeds; only the mean if it has no width; else a dash.

    Args:
        values: The value of each run.
        seeds: The seed of each run.
    """
    if not values:
        return "-"
    mean = bootstrap_mean(np.array(values)[:, np.newaxis], seeds)
    text, (low,), (high,) = _digits(mean.mean[0]), mean.low, mean.high
    return f"{text} ({_digits(low)} to {_digits(high)})" if low < high else text


def binomial_interval(successes: int, tests: int) -> Tuple[float, float]:
    """Return the exact 95 % interval (Clopper and Pearson) of a share, for independent tests."""
    low = float(beta.ppf(0.025, successes, tests - successes + 1)) if successes else 0.0
    high = float(beta.ppf(0.975, successes + 1, tests - successes)) if successes < tests else 1.0
    return low, high


def mean_table(rows: Rows, group: str, column: str, value: str) -> List[str]:
    """Return a table of mean values over seeds: a line for each group, a column for each number of another key."""
    columns = sorted({row[column] for row in rows}, key=float)
    lines = []
    for name in dict.fromkeys(row[group] for row in rows):
        cells = [[row for row in rows if (row[group], row[column]) == (name, at)] for at in columns]
        lines.append([name, *(row_interval(found, value) for found in cells)])
    return markdown((group, *(f"{column} {at}" for at in columns)), lines)


def row_interval(rows: Rows, value: str) -> str:
    """Return the interval of a value over rows with a seed."""
    return interval([float(row[value]) for row in rows], [row["seed"] for row in rows])


def row_curves(rows: Rows, group: str, x: str, y: str) -> List[Curve]:
    """Return a curve for each group: means with 95 % intervals over the seeds of the rows with the same x."""
    curves = []
    for name in dict.fromkeys(row[group] for row in rows):
        members = [row for row in rows if row[group] == name]
        places = sorted({float(row[x]) for row in members})
        at = [[row for row in members if float(row[x]) == place] for place in places]
        means = [
            bootstrap_mean(np.array([[float(row[y])] for row in part]), [row["seed"] for row in part]) for part in at
        ]
        mean, low, high = (np.array([getattr(item, part)[0] for item in means]) for part in ("mean", "low", "high"))
        curves.append(Curve(name, np.array(places), mean, low, high))
    return curves


def replace_block(path: Path, name: str, lines: Sequence[str]) -> None:
    """Replace the lines between `<!-- name -->` and `<!-- end -->` in a file.

    Raises:
        CorruptFileError: The file has no such block.
    """
    text = _READER.read_text(path)
    start, end = f"<!-- {name} -->\n", "<!-- end -->"
    head, found, rest = text.partition(start)
    _, closed, tail = rest.partition(end)
    if not (found and closed):
        raise _READER.make_error(path, f"has no block <!-- {name} --> ... <!-- end -->")
    write_text(path, "".join([head, start, *(f"{line}\n" for line in lines), end, tail]))


def _run_row(record: Record) -> List[object]:
    """Return the cells of a run."""
    summary, exploration = record.summary, record.config.exploration
    errors = [summary.mse_own, summary.mse_shuffled, summary.mse_none]
    return [
        record.variant,
        record.config.simulation.world,
        exploration.seed,
        summary.steps,
        _or_dash(final_ergodic_measure(record)),
        _or_dash(summary.coverage),
        "-" if summary.active_units is None else f"{summary.active_units:.0f}",
        " / ".join(f"{value:.2g}" for value in errors if value is not None) or "-",
        _or_dash(summary.distance),
        record.failure or _objects(record),
        summary.wall_time / 60.0,
    ]


def _objects(record: Record) -> str:
    """Describe the object clusters of a run by the nearest true object and the distance to it."""
    found = [item for item in record.objects if item.kind != BLANK and item.distance is not None]
    return ", ".join(f"{item.nearest} {100.0 * (item.distance or 0.0):.1f}" for item in found) or "none"


def _or_dash(value: Optional[float]) -> object:
    return "-" if value is None else value


def _text(value: object) -> str:
    return _digits(value) if isinstance(value, float) else str(value)


def _digits(value: float) -> str:
    """Return three digits, without an exponent for large numbers."""
    return f"{value:.0f}" if 1000.0 <= abs(value) < 1e6 else f"{value:.3g}"
