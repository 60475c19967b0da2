"""Compare runs: mean and bootstrap 95 % interval over seeds of every column of their tables, as figure and CSV.

    rosrun embodied_active_learning compare_sessions experiments/results/learning_metrics --by exploration/explorer

Runs are sessions, records of a sweep, or folders of records. Prints the last values as a table, and writes
comparison.csv, comparison.png and comparison.pdf.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Dict, List, Mapping, Sequence, Tuple

from embodied_active_learning.errors import EmbodiedActiveLearningError
from embodied_active_learning.figures.curves import Curve, draw_curves
from embodied_active_learning.session.tables import COLUMNS
from embodied_active_learning.sweep.comparison import (
    compare_columns,
    comparison_rows,
    group_records,
    load_records,
    with_unit,
)
from embodied_active_learning.sweep.csv_files import write_rows
from embodied_active_learning.sweep.run_records import Record
from embodied_active_learning.sweep.spec import differences


def main(arguments: Sequence[str]) -> int:
    """Compare the runs. Return 0, or 2 if they cannot be compared."""
    parser = argparse.ArgumentParser(
        prog="compare_sessions", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="folder of a session, a record, or records")
    parser.add_argument("--by", default="variant", help="setting that distinguishes the groups, or variant (default)")
    parser.add_argument("--output", type=Path, default=Path(), help="folder of the files (default: this one)")
    options = parser.parse_args(arguments)
    try:
        groups = group_records(load_records(options.runs), options.by)
        curves = compare_columns(groups)
        write_rows(options.output / "comparison.csv", comparison_rows(curves))
        panels, axes = _panels(curves)
        figure = draw_curves(options.output / "comparison.png", panels, axes)
    except EmbodiedActiveLearningError as error:
        print(error, file=sys.stderr)  # noqa: T201 - a command
        return 2
    print("\n".join([*_last_values(curves), *_mixed_runs(groups), str(figure.absolute())]))  # noqa: T201
    return 0


def _mixed_runs(groups: Mapping[str, List[Record]]) -> List[str]:
    """Return a line if runs without a variant differ in more than the seed; a variant may have several worlds."""
    runs = groups.get("", [])
    changed = {item.split(" ")[0] for other in runs for item in differences(runs[0].config, other.config)}
    keys = sorted(changed - {"exploration/seed"})
    return [f"runs of one group differ in {', '.join(keys)}: see --by"] if keys else []


def _panels(curves: Mapping[Tuple[str, str], List[Curve]]) -> Tuple[Dict[str, List[Curve]], Dict[str, str]]:
    """Return curves and axis labels by the name of the panel.

    A column of two tables has two panels, and one with a single row in every group has none.
    """
    panels: Dict[str, List[Curve]] = {}
    axes: Dict[str, str] = {}
    for (table, column), found in curves.items():
        if any(curve.x[-1] > curve.x[0] for curve in found):
            name = with_unit(column)
            name = name if name not in panels else f"{name} ({table})"
            panels[name], axes[name] = found, COLUMNS[table][0]
    return panels, axes


def _last_values(curves: Mapping[Tuple[str, str], List[Curve]]) -> List[str]:
    """Return a Markdown table of the last values."""
    lines = ["| column | group | mean | 95 % interval |", "| --- | --- | --- | --- |"]
    for (table, column), found in curves.items():
        for curve in found:
            interval = f"{curve.low[-1]:.4g} to {curve.high[-1]:.4g}" if curve.low[-1] == curve.low[-1] else "-"
            lines.append(f"| {table}/{column} | {curve.label} | {curve.mean[-1]:.4g} | {interval} |")
    return lines


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
