#!/usr/bin/env python3
"""Compare the planner with other coverage methods on densities on the unit square.

    source setup.bash && OPENBLAS_NUM_THREADS=1 python3 experiments/coverage_benchmark.py [--seeds 5]

Rows are written to experiments/results/coverage/coverage.csv as they are made; an interrupted call continues. The
spectral metric uses 20 x 20 cosine coefficients. Each seed has a start of its own.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Dict, Iterator, List

from embodied_active_learning.evaluation.coverage import METHODS, PLANS_WHOLE
from embodied_active_learning.evaluation.spectral import DENSITIES, SpectralMetric, kl_measure
from embodied_active_learning.sweep.csv_files import append_rows, read_rows

RESULTS = Path(__file__).resolve().parent / "results" / "coverage" / "coverage.csv"


def main() -> None:
    """Make the missing rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--lengths", type=int, nargs="+", default=[100, 300, 1000], help="steps, in ascending order")
    parser.add_argument("--output", type=Path, default=RESULTS)
    options = parser.parse_args()
    made = {(row["density"], row["method"], row["seed"]) for row in read_rows(options.output, missing_ok=True)}
    for seed in range(options.seeds):
        for density in DENSITIES:
            for method in METHODS:
                if (density, method, str(seed)) not in made:
                    append_rows(options.output, list(rows(density, method, seed, options.lengths)))
                    print(f"{density}, {method}, seed {seed}", flush=True)


def rows(density: str, method: str, seed: int, lengths: List[int]) -> Iterator[Dict[str, object]]:
    """Yield a row for each length of a trajectory."""
    metric = SpectralMetric.of(DENSITIES[density])
    for length in lengths if method in PLANS_WHOLE else lengths[-1:]:
        start = time.process_time()
        positions = METHODS[method](DENSITIES[density], length, seed)
        milliseconds = 1e3 * (time.process_time() - start) / length
        for steps in [length] if method in PLANS_WHOLE else lengths:
            yield {
                "density": density,
                "method": method,
                "seed": seed,
                "steps": steps,
                "spectral": metric.value(positions[:steps]),
                "kl": kl_measure(positions[:steps], DENSITIES[density]),
                "ms_per_step": milliseconds,
            }


if __name__ == "__main__":
    main()
