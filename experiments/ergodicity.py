#!/usr/bin/env python3
"""Measure how time averages along runs approach ensemble averages, for each explorer.

    source setup.bash && python3 experiments/ergodicity.py SESSION [--seeds 2] [--steps 1000]

The session's model is fixed, and its predicted standard deviation is the target h. Each explorer moves the simulated
arm without training. References are 1000 views drawn independently from h and from the uniform distribution. Rows are
written to experiments/results/ergodicity/ergodicity.csv as they are made; an interrupted call continues.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Dict, Iterator

import numpy as np

from embodied_active_learning.evaluation.ergodicity import (
    average_error,
    draw_independent,
    fixed_log_std,
    follow_target,
    two_sample_test,
    view_features,
)
from embodied_active_learning.pipeline.api import load_session
from embodied_active_learning.session.session_model import load_session_model
from embodied_active_learning.simulation.scene import Scene
from embodied_active_learning.simulation.simulation import Simulation
from embodied_active_learning.simulation.world import load_world
from embodied_active_learning.sweep.csv_files import append_rows, read_rows

EXPLORERS = ("ergodic", "uniform_ergodic", "random_walk", "uniform")
LENGTHS = (30, 50, 100, 200, 300, 500, 700, 1000)
REFERENCE_VIEWS, LATENTS, REFERENCE_SEED = 1000, 10, 1000
RESULTS = Path(__file__).resolve().parent / "results" / "ergodicity" / "ergodicity.csv"


class Measurement:
    """The model, the target and the reference views of a session."""

    def __init__(self, session_path: Path) -> None:
        session = load_session(session_path)
        found = load_session_model(session)
        if found is None:
            raise SystemExit(f"{session_path} has no trained model yet: finish the run first")
        self.name, self.config, self.model, self.updates = session.name, session.config, found.model, found.updates
        self.world = load_world(self.config.simulation.world, self.config.workspace.box())
        with session.open_observations() as store:
            stored = store.snapshot()
        chosen = np.random.default_rng(REFERENCE_SEED).choice(len(stored.stamps), LATENTS, replace=False)
        latents, _ = self.model.encode(stored.raw_states[chosen], stored.images[chosen])
        self.log_std = fixed_log_std(self.model, latents)
        scene = Scene(self.world, self.config.camera)
        self.references = {}
        for name, target in (("h", self.log_std), ("uniform", lambda states: np.zeros(len(states)))):
            views = draw_independent(self.config, scene, target, REFERENCE_VIEWS, REFERENCE_SEED)
            self.references[name] = view_features(self.model, views)
        scene.close()

    def rows(self, explorer: str, seed: int, steps: int) -> Iterator[Dict[str, object]]:
        """Yield a row for each reference and length of a run."""
        exploration = replace(self.config.exploration, explorer=explorer, seed=seed)
        config = replace(self.config, exploration=exploration)
        with Simulation(self.world, config) as simulation:
            features = view_features(self.model, follow_target(config, simulation, self.log_std, steps))
        for name, reference in self.references.items():
            for length in (item for item in LENGTHS if item <= steps):
                test = two_sample_test(features[:length], reference, seed)
                yield {
                    "session": self.name,
                    "updates": self.updates,
                    "explorer": explorer,
                    "seed": seed,
                    "reference": name,
                    "steps": length,
                    "error": average_error(features[:length], reference),
                    "mmd2": test.mmd2,
                    "p_value": test.p_value,
                }


def main() -> None:
    """Make the missing rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("session", type=Path)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--output", type=Path, default=RESULTS)
    options = parser.parse_args()
    made = {(row["session"], row["explorer"], row["seed"]) for row in read_rows(options.output, missing_ok=True)}
    wanted = [(explorer, seed) for seed in range(options.seeds) for explorer in EXPLORERS]
    left = [(explorer, seed) for explorer, seed in wanted if (options.session.name, explorer, str(seed)) not in made]
    if left:
        measurement = Measurement(options.session)
        for explorer, seed in left:
            append_rows(options.output, list(measurement.rows(explorer, seed, options.steps)))
            print(f"{explorer}, seed {seed}", flush=True)


if __name__ == "__main__":
    main()
