#!/usr/bin/env python3
"""Measure the models of the ablations on the same views, and search for their fingerprints in a new environment.

    source setup.bash
    python3 -m embodied_active_learning.sweep experiments/ablations.yaml
    python3 -m embodied_active_learning.sweep experiments/identification_images.yaml
    python3 experiments/ablation_models.py SWEEPS/ablations SWEEPS/identification_images/even-star-plant-duck-seed100

A run evaluates its model on its own observations, which differ between explorers. Here the views are drawn
independently from the whole workspace; those within 6 cm of an object are also averaged separately. Rows are written to
experiments/results/ablation_models/ablation_models.csv; sessions that have a row are skipped.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Dict, List

import numpy as np
from table1 import finished

from embodied_active_learning.errors import ObservationError
from embodied_active_learning.evaluation.ergodicity import draw_independent, view_features
from embodied_active_learning.evaluation.table1 import RULES, ensure_fingerprints, measure
from embodied_active_learning.objects.scoring import true_kinds
from embodied_active_learning.pipeline.api import load_session
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.session_model import load_session_model
from embodied_active_learning.simulation.scene import Scene
from embodied_active_learning.simulation.truth import true_objects
from embodied_active_learning.simulation.world import load_world
from embodied_active_learning.sweep.csv_files import append_rows, read_rows

NEAR, VIEWS, SEED = 0.06, 600, 1000
RESULTS = Path(__file__).resolve().parent / "results" / "ablation_models" / "ablation_models.csv"


def main() -> None:
    """Make the missing rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", type=Path, help="folder of the sessions that learned the models")
    parser.add_argument("images", type=Path, help="session with the images of the new environment")
    parser.add_argument("--count", type=int, default=500, help="images to search")
    parser.add_argument("--output", type=Path, default=RESULTS)
    options = parser.parse_args()
    images = load_session(options.images)
    made = {row["model"] for row in read_rows(options.output, missing_ok=True)}
    for session in finished(options.models, "*"):
        if session.name not in made:
            row = {"model": session.name, **view_errors(session), **successes(session, images, options.count)}
            append_rows(options.output, [row])
            print(row, flush=True)


def view_errors(session: Session) -> Dict[str, object]:
    """Return the mean squared errors of the session's model on views drawn independently of its run."""
    found, config = load_session_model(session), session.config
    if found is None:
        raise SystemExit(f"{session.paths.path} has no trained model: finish the run first")
    places = np.array([[item.x, item.y] for item in true_objects(config)])
    scene = Scene(load_world(config.simulation.world, config.workspace.box()), config.camera)
    views = draw_independent(config, scene, lambda states: np.zeros(len(states)), VIEWS, SEED)
    scene.close()
    errors = view_features(found.model, views)[:, -1]
    near = np.linalg.norm(views.states[:, np.newaxis, :2] - places, axis=-1).min(axis=1) < NEAR
    return {"error_everywhere": float(errors.mean()), "error_near_objects": float(errors[near].mean())}


def successes(session: Session, images: Session, count: int) -> Dict[str, object]:
    """Return the kinds with fingerprints, and the objects found again under both rules of Table 1.

    Objects of a kind that has no fingerprint count as not found.
    """
    kinds = {item.kind for item in true_objects(session.config)}
    rows: List[Dict[str, object]] = []
    try:
        fingerprints = ensure_fingerprints(session)
        rows = [row for row in measure(session, images, count) if row["kind"] in kinds]
        learned = kinds & set(true_kinds(fingerprints, true_objects(session.config)).values())
    except ObservationError as error:  # a variant may learn nothing
        print(f"{session.name}: {error}", flush=True)
        learned = set()
    missed = sum(item.kind in kinds - learned for item in true_objects(images.config))
    result: Dict[str, object] = {"kinds_learned": len(learned), "kinds": len(kinds)}
    for rule in RULES:
        chosen = [row for row in rows if row["rule"] == rule]
        result[f"{rule}_hits"] = sum(int(str(row["hits"])) for row in chosen)
        result[f"{rule}_tests"] = missed + sum(int(str(row["tests"])) for row in chosen)
    return result


if __name__ == "__main__":
    main()
