#!/usr/bin/env python3
"""Runs every benchmark, one after the other, each in a process of its own; prints all tables and writes JSON.

    source setup.bash && python3 benchmarks/run_all.py build/benchmarks.json [--docs]

--docs puts the tables into docs/performance.md.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import List, Tuple

from measuring import Section, machine, read_json, table, write_json

HERE = Path(__file__).parent
DOCUMENT = HERE.parent / "docs" / "performance.md"
BEGIN, END = "<!-- tables: written by make bench-docs -->", "<!-- end of tables -->"
BENCHMARKS = ("update", "planner", "camera", "identification", "run")


def main() -> None:
    """Run, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("json", type=Path, help="file to write the results to")
    parser.add_argument("--docs", action="store_true", help="put the tables into docs/performance.md")
    arguments = parser.parse_args()
    if arguments.docs:
        parts_of_document()  # before the time is spent
    sections: List[Section] = []
    begin = time.monotonic()
    for name in BENCHMARKS:
        print(f"--- {name}, {time.monotonic() - begin:.0f} s since the start", flush=True)
        sections += measured(name)
        write_json(arguments.json, sections)
    print(f"{time.monotonic() - begin:.0f} s; results in {arguments.json}")
    if arguments.docs:
        put_into_document(sections)


def measured(name: str) -> List[Section]:
    """Run one benchmark, which prints its tables -> its sections."""
    # numpy's second thread would only spin, as in the launch file.
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "results.json"
        subprocess.run(
            [sys.executable, str(HERE / f"benchmark_{name}.py"), "--json", str(path)], check=True, env=environment
        )
        return read_json(path)


def parts_of_document() -> Tuple[str, str]:
    """What stands before the tables and behind them. Raises SystemExit where the document has no place for them."""
    text = DOCUMENT.read_text(encoding="utf-8") if DOCUMENT.exists() else ""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise SystemExit(f"{DOCUMENT} lacks the lines {BEGIN!r} and {END!r}, between which the tables go")
    return before, after


def put_into_document(sections: List[Section]) -> None:
    """Replace the tables between the two marks."""
    before, after = parts_of_document()
    on = ", ".join(f"{name} {value}" for name, value in machine().items())
    tables = "\n".join(table(section) for section in sections)
    DOCUMENT.write_text(f"{before}{BEGIN}\n\nMeasured on: {on}.\n\n{tables}\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
