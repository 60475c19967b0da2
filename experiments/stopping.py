#!/usr/bin/env python3
"""Evaluate the stopping criterion (exploration/stop: stable) on random worlds against fixed numbers of steps.

    source setup.bash && OMP_NUM_THREADS=1 python3 experiments/stopping.py 2-1 3-7 [--stop fixed] [--reserved]

A world is COUNT-SEED: its number of objects (0: an empty table) and the seed of objects, places and table. It is
learned until the criterion stops it, or with `--stop fixed` for all steps. Then the model of each check is evaluated:
a run that ends early is the beginning of the longer one, so one run of all steps shows the objects at the stop and
after fixed numbers of steps. The script can be interrupted at any time and skips finished worlds. It writes two tables:
the checks, and the objects at the stop and after fixed numbers of steps. With --fingerprint, each of these models
becomes a session WORLD-STEPS with fingerprints, for identification.py.
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path
from typing import Any, Dict, List

import numpy as np
from scipy.optimize import linear_sum_assignment

import embodied_active_learning as eal
from embodied_active_learning.config import Config
from embodied_active_learning.model.learner_state import network_weights
from embodied_active_learning.model.metrics import Evaluation
from embodied_active_learning.model.trained_model import TrainedModel
from embodied_active_learning.objects.clustering import find_objects
from embodied_active_learning.objects.scoring import SAME_PLACE
from embodied_active_learning.objects.stability import StoppingCriterion
from embodied_active_learning.pipeline.stopping import CHECK_EVERY, measure
from embodied_active_learning.session.fingerprints import has_fingerprints
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.summary import read_summary
from embodied_active_learning.session.tables import COLUMNS
from embodied_active_learning.session.tensor_files import read_tensors
from embodied_active_learning.simulation.random_world import SHIPPED, is_wide, random_world, write_world
from embodied_active_learning.simulation.truth import true_objects
from embodied_active_learning.sweep.csv_files import append_rows, read_rows

SHOWN = (300, 600, 1000, 3000)  # steps after which objects are shown
KINDS = 6  # procedural objects to draw from, beside the shipped ones


def world_file(root: Path, count: int, seed: int, reserved: bool) -> Path:
    """Return a world of objects on a random table; reserved worlds have other procedural objects."""
    path = root / f"{count}-{seed}{'-reserved' if reserved else ''}.yaml"
    if not path.exists():
        numbers = np.random.default_rng(seed + 7000).permutation(500)[:60] + (500 if reserved else 0)
        names = (f"random_urdfs/{number:03d}" for number in numbers)
        kinds = (*SHIPPED, *[name for name in names if is_wide(name)][:KINDS])
        write_world(random_world(seed, count, kinds=kinds), path)
    return path


def learn(world: Path, root: Path, steps: int, stop: str) -> Session:
    """Learn a world with a checkpoint for every check, unless that was done before."""
    path = root / world.stem
    if (path / "summary.yaml").exists() and read_summary(path / "summary.yaml").finished:
        return Session.open_read_only(path)
    shutil.rmtree(path, ignore_errors=True)
    every = 3 * CHECK_EVERY
    training = {
        "checkpoint_every": every,
        "checkpoints_kept": steps // CHECK_EVERY,
        "evaluate_every": every,
        "threads": 1,
    }
    session = {"name": path.name, "root": str(root)}
    values = {"world": str(world), "steps": steps, "stop": stop, "seed": 1}
    return eal.learn(eal.load_config("demo", **values, session=session, training=training))


def evaluate(session: Session) -> Dict[str, List[Dict[str, Any]]]:
    """Return the checks of a session, and its objects at the stop and after fixed numbers of steps."""
    config, criterion = session.config, StoppingCriterion()
    plan = config.update_plan
    evaluations, training = session.read_table("evaluation"), session.read_table("training")
    truth = np.array([(item.x, item.y) for item in true_objects(config)], dtype=float).reshape(-1, 2)
    rows: Dict[str, List[Dict[str, Any]]] = {"checks": [], "objects": []}
    with session.open_observations() as store:
        stored = store.snapshot()
    due = evaluations["update"].astype(int) % (config.training.updates_per_observation * CHECK_EVERY) == 0
    for index in np.flatnonzero(due):
        update = int(evaluations["update"][index])
        values = {name: column[index] for name, column in evaluations.items()}
        evaluation = Evaluation(**{**values, "update": update, "observations": int(values["observations"])})
        path = session.paths.checkpoints / f"checkpoint_{update:09d}.safetensors"
        model = TrainedModel(config, network_weights(read_tensors(path, "checkpoint")[0]))
        steps = plan.observations_awaiting(update)
        rules = [f"after {fixed}" for fixed in SHOWN if steps - CHECK_EVERY < fixed <= steps]
        if steps == plan.steps:  # the remaining updates at the end of the run
            rules = [f"after {steps}"] if update == plan.total else []
        check = criterion.add(measure(config, model, evaluation, float(training["coverage"][update - 1]), stored))
        if check.stopped and not any(row["rule"] == "stable" for row in rows["objects"]):
            rules.append("stable")
        parts = {name: round(float(getattr(check, name)), 4) for name in COLUMNS["stopping"][2:]}
        rows["checks"].append({"world": session.name, "steps": steps, **parts})
        count = evaluation.observations
        for rule in rules:
            found = find_objects(model, stored.raw_states[:count], stored.images[:count], config, 1, blank=False)
            centres = [item.centre[:2] for item in (*found.clusters, *found.unreachable)]
            facts = {"world": session.name, "rule": rule, "steps": steps}
            rows["objects"].append({**facts, **compare(np.array(centres).reshape(-1, 2), truth)})
        if "stable" in rules and config.may_stop_early:
            break
    return rows


def store_fingerprints(session: Session, steps: int, root: Path) -> None:
    """Store a session that ends after a number of steps, and its fingerprints, unless that was done before.

    Args:
        session: The longer run, with its checkpoints.
        steps: At which the longer run has a checkpoint.
        root: Folder of the shorter session.
    """
    name = f"{session.name}-{steps}"
    if has_fingerprints(root / name):
        return
    shutil.rmtree(root / name, ignore_errors=True)
    updates = session.config.update_plan.awaited(steps)
    values = session.config.to_dict()
    values["session"].update(name=name, root=str(root))
    values["exploration"].update(steps=steps, stop="fixed")
    with session.open_observations() as store:
        stored = store.snapshot()
    with Session.open_for_writing(Config.from_dict(values)) as shorter, shorter.open_observations() as store:
        for index in range(steps):
            store.append(index, stored.stamps[index], stored.raw_states[index], stored.images[index])
        path = f"checkpoint_{updates:09d}.safetensors"
        shorter.paths.checkpoints.mkdir()
        shutil.copy(session.paths.checkpoints / path, shorter.paths.checkpoints / path)
    found = eal.fingerprint(root / name)
    print(name, [f"{item.name}: {item.centre[:2].round(3)}" for item in found.fingerprints], flush=True)


def compare(found: np.ndarray, truth: np.ndarray) -> Dict[str, Any]:
    """Compare the centres of clusters (K, 2) with those of the true objects (N, 2) [m]."""
    distances = np.linalg.norm(found[:, np.newaxis] - truth[np.newaxis], axis=-1)
    errors = distances[linear_sum_assignment(distances)]
    errors = errors[errors <= SAME_PLACE]
    right = len(errors) == len(truth) == len(found)
    error = round(100.0 * float(np.median(errors)), 2) if len(errors) else ""
    return {"true": len(truth), "found": len(found), "matched": len(errors), "right": int(right), "error_cm": error}


def main() -> None:
    """Learn and evaluate the worlds that are not in the tables yet."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("worlds", nargs="+", help="COUNT-SEED, such as 2-1")
    parser.add_argument("--steps", type=int, default=1000, help="largest number of steps")
    parser.add_argument("--stop", choices=("stable", "fixed"), default="stable", help="when a run ends")
    parser.add_argument("--reserved", action="store_true", help="other objects, for a final report")
    parser.add_argument("--root", type=Path, default=Path("~/.ros/embodied_active_learning/stopping"))
    parser.add_argument("--results", type=Path, default=Path(__file__).parent / "results" / "stopping")
    parser.add_argument("--keep", action="store_true", help="keep the checkpoints, about 1.5 GB for each world")
    parser.add_argument("--fingerprint", action="store_true", help="store sessions with fingerprints; implies --keep")
    options = parser.parse_args()
    root, results = options.root.expanduser(), options.results
    root.mkdir(parents=True, exist_ok=True)
    for name in options.worlds:
        count, seed = map(int, name.split("-"))
        world = world_file(root, count, seed, options.reserved)
        if not any(row["world"] == world.stem for row in read_rows(results / "stopping_checks.csv", missing_ok=True)):
            session = learn(world, root, options.steps, options.stop)
            rows = evaluate(session)
            append_rows(results / "stopping_objects.csv", rows["objects"])
            append_rows(results / "stopping_checks.csv", rows["checks"])
            for row in rows["objects"]:
                print("  ".join(f"{key} {value}" for key, value in row.items()), flush=True)
            if not (options.keep or options.fingerprint):
                shutil.rmtree(session.paths.checkpoints)
        if options.fingerprint:
            session = learn(world, root, options.steps, options.stop)
            of_world = [row for row in read_rows(results / "stopping_objects.csv") if row["world"] == world.stem]
            for steps in sorted({int(row["steps"]) for row in of_world}):
                store_fingerprints(session, steps, root)


if __name__ == "__main__":
    main()
