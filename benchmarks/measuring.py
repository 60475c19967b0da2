"""Shared code of the benchmarks: alternating measurements, memory, and results as tables or JSON."""

from __future__ import annotations

import argparse
import ctypes
import json
import platform
import resource
import statistics
import subprocess
import tempfile
import threading
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Callable, Dict, List, NamedTuple, Optional, Sequence

from embodied_active_learning.model.native.library import processor_name

WARM_UP = 2
PEAK_SOURCE = Path(__file__).with_name("peak.c")
PEAK_FLAGS = ("-O3", "-march=native", "-shared", "-fPIC")
PEAK_ROUNDS = 5


class Turn(NamedTuple):
    """Wall time and processor time [ms] of one call in this process, and its page faults."""

    wall: float
    cpu: float
    faults: int


@dataclass
class Row:
    """One measurement. Times [ms] and page faults are medians; ratio: speed-up over the naive variant."""

    what: str
    wall: Optional[float] = None
    p90: Optional[float] = None
    cpu: Optional[float] = None
    faults: Optional[int] = None
    ratio: Optional[float] = None
    peak_share: Optional[float] = None
    value: str = ""
    target: str = ""


@dataclass
class Section:
    """A table: title, description and rows."""

    title: str
    how: str
    rows: List[Row] = field(default_factory=list)


def take_turns(
    variants: Dict[str, Callable[[], object]],
    rounds: int,
    prepare: Callable[[str], object] = lambda name: None,
) -> Dict[str, List[Turn]]:
    """Call the variants alternately. The first rounds, and prepare(name) before each call, are not counted."""
    turns: Dict[str, List[Turn]] = {name: [] for name in variants}
    for _ in range(WARM_UP + rounds):
        for name, call in variants.items():
            prepare(name)
            turns[name].append(timed(call))
    return {name: taken[WARM_UP:] for name, taken in turns.items()}


def timed(call: Callable[[], object]) -> Turn:
    """Measure one call."""
    faults, cpu, wall = _faults(), time.process_time(), time.perf_counter()
    call()
    elapsed = time.perf_counter() - wall
    return Turn(1e3 * elapsed, 1e3 * (time.process_time() - cpu), _faults() - faults)


def row(what: str, turns: Sequence[Turn], naive: Optional[Sequence[Turn]] = None, target: str = "") -> Row:
    """Return the medians of the turns, and the median ratio to the naive turns of the same rounds."""
    walls = [turn.wall for turn in turns]
    ratio = statistics.median(slow.wall / fast.wall for slow, fast in zip(naive, turns)) if naive else None
    p90 = sorted(walls)[min(len(walls) - 1, int(0.9 * len(walls)))]
    cpu, faults = (statistics.median(column) for column in list(zip(*turns))[1:])
    return Row(what, statistics.median(walls), p90, cpu, int(faults), ratio, target=target)


def rows_of(turns: Dict[str, List[Turn]], targets: Optional[Dict[str, str]] = None) -> List[Row]:
    """Return a row for each variant; the first is the naive one."""
    naive = next(iter(turns.values()))
    targets = targets or {}
    return [row(name, taken, naive, targets.get(name, "")) for name, taken in turns.items()]


def single_precision_peak(threads: int) -> Optional[float]:
    """Return the peak of multiply-adds on a number of threads [GFLOP/s], the best of a few rounds.

    None without a compiler.
    """
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "peak.so"
        try:
            subprocess.run(["gcc", *PEAK_FLAGS, "-o", str(library), str(PEAK_SOURCE)], check=True, capture_output=True)
        except (OSError, subprocess.CalledProcessError):
            return None
        peak = ctypes.CDLL(str(library)).multiply_and_add
        peak.restype = ctypes.c_double
        return max(_peak_once(peak, threads) for _ in range(PEAK_ROUNDS))


def resident_memory() -> float:
    """Return the resident memory of this process [MiB]."""
    for line in Path("/proc/self/status").read_text(encoding="utf-8").splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024.0
    raise OSError("no VmRSS in /proc/self/status")


def machine() -> Dict[str, str]:
    """Return processor, Python and system."""
    processor = processor_name() or "unknown"
    return {"processor": processor, "python": platform.python_version(), "system": platform.platform(terse=True)}


def table(section: Section) -> str:
    """Return the section as Markdown."""
    shown = [
        ("", lambda row: row.what),
        ("median [ms]", lambda row: _number(row.wall, 2)),
        ("p90 [ms]", lambda row: _number(row.p90, 2)),
        ("processor [ms]", lambda row: _number(row.cpu, 2)),
        ("page faults", lambda row: f"{row.faults}" if row.faults else ""),
        ("times faster", lambda row: _number(row.ratio, 2)),
        ("of peak", lambda row: "" if row.peak_share is None else f"{100.0 * row.peak_share:.0f} %"),
        ("measured", lambda row: row.value),
        ("wanted", lambda row: row.target),
    ]
    columns = [(head, [text(row) for row in section.rows]) for head, text in shown]
    columns = [(head, cells) for head, cells in columns if not head or any(cells)]
    lines = [f"### {section.title}", "", section.how, ""]
    lines.append("| " + " | ".join(head for head, _ in columns) + " |")
    lines.append("|" + " --- |" * len(columns))
    lines += ["| " + " | ".join(cells) + " |" for cells in zip(*(cells for _, cells in columns))]
    return "\n".join(lines) + "\n"


def write_json(path: Path, sections: Sequence[Section]) -> None:
    """Write machine and sections."""
    path.parent.mkdir(parents=True, exist_ok=True)
    content = {"machine": machine(), "sections": [asdict(section) for section in sections]}
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def read_json(path: Path) -> List[Section]:
    """Read the sections that write_json has written."""
    content = json.loads(path.read_text(encoding="utf-8"))
    return [
        Section(section["title"], section["how"], [Row(**row) for row in section["rows"]])
        for section in content["sections"]
    ]


def run(description: Optional[str], measure: Callable[[argparse.Namespace], List[Section]], **options: int) -> None:
    """Main function of a benchmark: parse options (name=default integer), print tables, write JSON if requested."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in options.items():
        parser.add_argument(f"--{name}", type=int, default=default, help=f"default {default}")
    parser.add_argument("--json", type=Path, help="also write the results to this file")
    arguments = parser.parse_args()
    sections = measure(arguments)
    for section in sections:
        print(table(section))
    if arguments.json:
        write_json(arguments.json, sections)


def _number(value: Optional[float], digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"


def _peak_once(peak: Callable[[int], float], threads: int) -> float:
    work, flop = 20_000_000, []
    workers = [threading.Thread(target=lambda: flop.append(peak(work))) for _ in range(threads)]
    begin = time.perf_counter()
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    return sum(flop) / (time.perf_counter() - begin) / 1e9


def _faults() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt
