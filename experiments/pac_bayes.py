#!/usr/bin/env python3
"""Measure the terms of the paper's PAC-Bayes bound for trained models.

    source setup.bash && python3 experiments/pac_bayes.py SESSION ... [--views 300]

Observations are drawn independently, once from the model's target h and once from the uniform distribution. Rows are
written to experiments/results/pac_bayes/pac_bayes.csv; sessions that have rows are skipped.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import Dict, Iterator

import numpy as np

from embodied_active_learning.evaluation.ergodicity import Views, draw_independent, fixed_log_std
from embodied_active_learning.evaluation.pac_bayes import bound_terms
from embodied_active_learning.pipeline.api import load_session
from embodied_active_learning.session.session_model import load_session_model
from embodied_active_learning.simulation.scene import Scene
from embodied_active_learning.simulation.world import load_world
from embodied_active_learning.sweep.csv_files import append_rows, read_rows

LATENTS, SEED = 10, 1000
RESULTS = Path(__file__).resolve().parent / "results" / "pac_bayes" / "pac_bayes.csv"


def main() -> None:
    """Make the missing rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sessions", nargs="+", type=Path)
    parser.add_argument("--views", type=int, default=300, help="observations of the bound, and as many for the risk")
    parser.add_argument("--output", type=Path, default=RESULTS)
    options = parser.parse_args()
    made = {row["session"] for row in read_rows(options.output, missing_ok=True)}
    for path in options.sessions:
        if path.name not in made:
            append_rows(options.output, list(rows(path, options.views)))
            print(path.name, flush=True)


def rows(path: Path, count: int) -> Iterator[Dict[str, object]]:
    """Yield the terms of one model for both distributions."""
    session = load_session(path)
    found = load_session_model(session)
    if found is None:
        raise SystemExit(f"{path} has no trained model yet: finish the run first")
    config, model = session.config, found.model
    workspace = config.workspace.box()
    with session.open_observations() as store:
        stored = store.snapshot()
    chosen = np.random.default_rng(SEED).choice(len(stored.stamps), LATENTS, replace=False)
    latents, _ = model.encode(stored.raw_states[chosen], stored.images[chosen])
    scene = Scene(load_world(config.simulation.world, workspace), config.camera)
    for name, target in (("h", fixed_log_std(model, latents)), ("uniform", lambda states: np.zeros(len(states)))):
        views = draw_independent(config, scene, target, 2 * count, SEED)
        sample, fresh = Views(*(part[:count] for part in views)), Views(*(part[count:] for part in views))
        terms = bound_terms(model.network, workspace, sample, fresh, SEED)
        key = {"session": path.name, "updates": found.updates, "distribution": name, "views": count}
        yield {**key, **asdict(terms), "bound": terms.bound}
    scene.close()


if __name__ == "__main__":
    main()
