#!/usr/bin/env python3
"""Run all benchmarks, each in a process of its own; print the tables and write JSON.

    source setup.bash && python3 benchmarks/run_all.py build/benchmarks.json [--docs]

--docs also writes the tables to docs/performance.md.
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
    """Run the benchmarks."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("json", type=Path, help="file to write the results to")
    parser.add_argument("--docs", action="store_true", help="write the tables to docs/performance.md")
    arguments = parser.parse_args()
    if arguments.docs:
        split_document()  # fails before the benchmarks run
    sections: List[Section] = []
    begin = time.monotonic()
    for name in BENCHMARKS:
        print(f"--- {name}, {time.monotonic() - begin:.0f} s since the start", flush=True)
        sections += run_benchmark(name)
        write_json(arguments.json, sections)
    print(f"{time.monotonic() - begin:.0f} s; results in {arguments.json}")
    if arguments.docs:
        write_document(sections)


def run_benchmark(name: str) -> List[Section]:
    """Run one benchmark, which prints its tables, and return its sections."""
    # As in the launch file: numpy's second thread would only spin.
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "results.json"
        subprocess.run(
            [sys.executable, str(HERE / f"benchmark_{name}.py"), "--json", str(path)], check=True, env=environment
        )
        return read_json(path)


def split_document() -> Tuple[str, str]:
    """Return the text before and after the tables. Raises SystemExit if the markers are missing."""
    text = DOCUMENT.read_text(encoding="utf-8") if DOCUMENT.exists() else ""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise SystemExit(
            f"{DOCUMENT}: marker lines {BEGIN!r} and {END!r} are missing; add them where the tables belong"
        )
    return before, after


def write_document(sections: List[Section]) -> None:
    """Replace the tables between the markers."""
    before, after = split_document()
    on = ", ".join(f"{name} {value}" for name, value in machine().items())
    tables = "\n".join(table(section) for section in sections)
    DOCUMENT.write_text(f"{before}{BEGIN}\n\nMeasured on: {on}.\n\n{tables}\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
