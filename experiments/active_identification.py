#!/usr/bin/env python3
"""Count the images until everything is decided, with active identification and with even coverage.

    source setup.bash && python3 experiments/active_identification.py SESSION_FOLDER ... --output FOLDER [--scenes 4]

The simulated arm moves over the scenes of experiments/identification_scenes.py, in the same worlds and with the same
seeds for each explorer. Rows are appended to results.csv, so that an interrupted call continues.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Dict, List, Sequence, Tuple

import numpy as np
import torch
from identification import Evaluation
from identification_scenes import CONDITIONS, judge

from embodied_active_learning.config import Config
from embodied_active_learning.objects.decision import Decision, decisions_about
from embodied_active_learning.objects.fingerprint import BLANK
from embodied_active_learning.objects.identification import Identification
from embodied_active_learning.pipeline.exploration import ExplorationRun
from embodied_active_learning.pipeline.identification import FIRST_EVALUATION, next_evaluation
from embodied_active_learning.simulation.simulation import Simulation
from embodied_active_learning.simulation.world import World
from embodied_active_learning.sweep.csv_files import append_rows, read_rows

EXPLORERS = ("active", "uniform_ergodic")


@dataclass(frozen=True)
class Row:
    """How one search ended."""

    condition: str
    scene: int
    explorer: str
    images: int
    decided: int
    present: int  # fingerprints of objects that are there
    hits: int
    undecided_present: int
    absent: int
    false_claims: int
    undecided_absent: int


COUNTS = ("decided", "present", "hits", "undecided_present", "absent", "false_claims", "undecided_absent")


def main() -> None:
    """Search all scenes and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sessions", nargs="+", type=Path)
    parser.add_argument("--output", required=True, type=Path)
    parser.add_argument("--conditions", nargs="*", default=["learned table", "other table", "all"], choices=CONDITIONS)
    parser.add_argument("--scenes", type=int, default=4, help="scenes of each condition")
    parser.add_argument("--first", type=int, default=0, help="number of the first scene")
    parser.add_argument("--reserved", action="store_true", help="use the reserved objects and tables")
    parser.add_argument("--images", type=int, default=1000, help="largest number of images")
    options = parser.parse_args()
    torch.set_num_threads(1)
    path = options.output / "results.csv"
    done = {(row["condition"], int(row["scene"]), row["explorer"]) for row in read_rows(path, missing_ok=True)}
    evaluation = Evaluation(options.sessions, reserved=options.reserved)
    for condition in options.conditions:
        for scene in range(options.first, options.first + options.scenes):
            for explorer in EXPLORERS:
                if (condition, scene, explorer) not in done:
                    row = run(evaluation, condition, scene, explorer, options.images)
                    append_rows(path, [asdict(row)])
                    print(row, flush=True)
    report(read_rows(path))


def run(evaluation: Evaluation, condition: str, scene: int, explorer: str, max_images: int) -> Row:
    """Search one scene with one explorer."""
    place = evaluation.scenes.draw(condition, scene)
    search = evaluation.search
    search.reset()
    decisions = explore(place.world, evaluation.config, search, explorer, scene, max_images)
    judged = [
        judge(decisions_about(decisions, *key), place, explorer, key, kind)
        for key, kind in evaluation.kinds.items()
        if kind != BLANK
    ]
    there, absent = ([row for row in judged if row.present == value] for value in (1, 0))
    return Row(
        condition,
        scene,
        explorer,
        search.image_count,
        int(search.all_closed),
        len(there),
        sum(row.hit for row in there),
        sum(row.undecided for row in there),
        len(absent),
        sum(row.false_claim for row in absent),
        sum(row.undecided for row in absent),
    )


def explore(
    world: World, config: Config, search: Identification, explorer: str, seed: int, max_images: int
) -> List[Decision]:
    """Move the simulated arm until everything is decided, as planner and identifier do together."""
    config = replace(config, exploration=replace(config.exploration, explorer=explorer, seed=seed))
    states: List[np.ndarray] = []
    images: List[np.ndarray] = []
    decisions: List[Decision] = []
    due = FIRST_EVALUATION
    with Simulation(world, config) as simulation:
        motion = ExplorationRun(config)
        while not search.all_closed and len(states) < max_images:
            states.append(simulation.pose)
            images.append(simulation.image())
            motion.observe(simulation.pose, simulation.velocity)
            motion.evaluate_step(None)
            search.observe(states[-1][None], images[-1][None])
            if len(states) >= min(due, max_images):
                decisions = search.decide(np.stack(states), np.stack(images))
                due = next_evaluation(len(states), search.open_count)
                motion.set_open_places(search.open_places)
            simulation.execute(motion.next_command())
    return decisions


def report(rows: Sequence[Dict[str, str]]) -> None:
    """Print images and outcomes of each condition and explorer."""
    print("\n| condition | explorer | images: median (range) | decided | hits | false claims | undecided |")
    print("| --- " * 7 + "|")
    groups: Dict[Tuple[str, str], List[Dict[str, str]]] = {}
    for row in rows:
        for condition in (row["condition"], "all rows above"):
            groups.setdefault((condition, row["explorer"]), []).append(row)
    for (condition, explorer), group in sorted(groups.items(), key=lambda item: item[0][0] == "all rows above"):
        count = {name: sum(int(row[name]) for row in group) for name in COUNTS}
        images = [int(row["images"]) for row in group]
        undecided = count["undecided_present"] + count["undecided_absent"]
        print(
            f"| {condition} | `{explorer}` | {np.median(images):.0f} ({min(images)}-{max(images)}) "
            f"| {count['decided']} / {len(group)} | {count['hits']} / {count['present']} "
            f"| {count['false_claims']} / {count['absent']} | {undecided} / {count['present'] + count['absent']} |"
        )


if __name__ == "__main__":
    main()
