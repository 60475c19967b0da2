#!/usr/bin/env python3
"""Measure the paper's Table 1: fingerprints of learned models in their own environments and in new ones.

    source setup.bash
    python3 -m embodied_active_learning.sweep experiments/learning_metrics.yaml          # the models
    python3 -m embodied_active_learning.sweep experiments/identification_images.yaml     # the images
    python3 experiments/table1.py SWEEPS/learning_metrics SWEEPS/identification_images

Every finished run of the ergodic explorer is a model. Missing fingerprints are collected. A model is tested in its own
environment and in all test environments of which there are images. Rows are written to
experiments/results/table1/table1.csv as they are made; an interrupted call continues.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Dict, List, Tuple

from embodied_active_learning.evaluation.table1 import PAPER, measure
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.summary import read_summary
from embodied_active_learning.sweep.csv_files import append_rows, read_rows

RESULTS = Path(__file__).resolve().parent / "results" / "table1" / "table1.csv"


def main() -> None:
    """Make the missing rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", type=Path, help="folder of the sessions that learned the models")
    parser.add_argument("images", type=Path, help="folder of the sessions with the images")
    parser.add_argument("--count", type=int, default=0, help="images of each environment; default: all")
    parser.add_argument("--output", type=Path, default=RESULTS)
    options = parser.parse_args()
    made = {(row["model"], row["images"]) for row in read_rows(options.output, missing_ok=True)}
    models = [item for item in finished(options.models) if item.config.exploration.explorer == "ergodic"]
    for model in models:
        for images in finished(options.images):
            environment = world(images)
            if (model.name, images.name) not in made and environment in (world(model), *PAPER):
                key = {"model": model.name, "images": images.name, "environment": environment}
                rows: List[Dict[str, object]] = [{**key, **row} for row in measure(model, images, options.count)]
                append_rows(options.output, rows)
                print(f"{model.name} in {images.name}: " + ", ".join(map(text, rows)), flush=True)


def finished(folder: Path) -> Tuple[Session, ...]:
    """Return the finished sessions in a folder, sorted by name."""
    found = [Session.open_read_only(path.parent) for path in sorted(folder.glob("*/summary.yaml"))]
    return tuple(session for session in found if read_summary(session.paths.summary).finished)


def world(session: Session) -> str:
    """Return the name of a session's world."""
    return Path(session.config.simulation.world).stem


def text(row: Dict[str, object]) -> str:
    """Return a row as text."""
    return f"{row['kind']} {row['rule']} {row['hits']}/{row['tests']}"


if __name__ == "__main__":
    main()
