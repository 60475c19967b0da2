"""Reproduces the paper's identification table in simulation, for stored sessions and workspaces, beside raw pixels.

    source setup.bash && python3 experiments/identification.py SESSION_FOLDER ... [--worlds stars_ducks right]

Every fingerprint of the sessions is looked for in each world, in images of an even (uniform ergodic) coverage, as they
are and with noise, another brightness or another table. Sessions without fingerprints get them first, by the simulated
arm. Images are kept below --images, so that later calls find the same ones.
"""

from __future__ import annotations

import argparse
import csv
from dataclasses import replace
from pathlib import Path
from typing import Iterator, List, NamedTuple, Sequence, Tuple

import numpy as np
import torch

from embodied_active_learning.config import Config, IdentificationConfig
from embodied_active_learning.objects.decision import FOUND, Decision
from embodied_active_learning.objects.fingerprint import BLANK, FingerprintSet
from embodied_active_learning.objects.identification import Identification
from embodied_active_learning.objects.report import SAME_PLACE, Truth, nearest, score
from embodied_active_learning.objects.search_target import SearchTarget
from embodied_active_learning.pipeline.exploration import ExplorationRun
from embodied_active_learning.pipeline.fingerprinting import FingerprintRun
from embodied_active_learning.session.fingerprints import has_fingerprints, load_fingerprints
from embodied_active_learning.session.session import Session
from embodied_active_learning.simulation.simulation import Simulation
from embodied_active_learning.simulation.truth import true_objects, true_scene
from embodied_active_learning.simulation.world import Disturbances, World, load_world

WORLDS = ("star_plant_duck", "plants_ducks", "stars_ducks", "stars_plants")
CONDITIONS = ("clean", "noise", "brightness", "texture")
NOISE = 10.0  # grey levels
BRIGHTNESS = 0.85
TEXTURE = "wood.png"
RANKED = "ranked (count known), our reading"
"""The paper does not state when a fingerprint counts as identified."""
STREAM_SEED = 100


class Outcome(NamedTuple):
    """How one set of fingerprints fared in one world."""

    condition: str
    features: str
    rule: str
    world: str
    session: str
    kind: str
    hits: int
    instances: int
    claims_false: int  # decisions that something is where it is not
    absent_false: int  # 1 if the kind is absent and was claimed
    absent: int  # 1 if the kind is absent
    errors: Tuple[float, ...]  # m


def main() -> None:
    """Evaluate, print the tables, write every number."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sessions", nargs="+", type=Path)
    parser.add_argument("--worlds", nargs="*", default=list(WORLDS), help="test workspaces")
    parser.add_argument("--conditions", nargs="*", default=list(CONDITIONS), choices=CONDITIONS)
    parser.add_argument("--count", type=int, default=2000, help="images of each world")
    parser.add_argument("--images", type=Path, default=Path("~/.ros/embodied_active_learning/identification_images"))
    parser.add_argument("--threads", type=int, default=0)
    options = parser.parse_args()
    if options.threads:
        torch.set_num_threads(options.threads)
    sets = [fingerprints(path) for path in options.sessions]
    centres(sets)
    outcomes: List[Outcome] = []
    folder = options.images.expanduser()
    folder.mkdir(parents=True, exist_ok=True)
    own = sorted({Path(found.config.simulation.world).stem for found in sets})
    for condition in options.conditions:
        for world in (own if condition == "clean" else []) + [name for name in options.worlds if name not in own]:
            states, images = stream(world, condition, options.count, folder)
            # The paper tests a session in its own workspace, and all sessions in the test workspaces.
            looked = (
                sets if world in options.worlds else [s for s in sets if Path(s.config.simulation.world).stem == world]
            )
            for features in ("latents", "pixels"):
                outcomes += evaluate(looked, world, condition, features, states, images)
                print(f"  {condition} {world} {features}", flush=True)
    report(outcomes, options.worlds)
    path = folder / "identification.csv"
    with path.open("w", newline="", encoding="utf-8") as stream_:
        writer = csv.writer(stream_)
        writer.writerow(Outcome._fields)
        writer.writerows(outcomes)
    print(path)


def fingerprints(path: Path) -> FingerprintSet:
    """The fingerprints of a session; collected now by the simulated arm if there are none."""
    if has_fingerprints(path):
        return load_fingerprints(path)
    run = FingerprintRun(path)
    print(f"{path.name}: {run.summary}", flush=True)
    config = load_config(path)
    with Simulation(load_world(config.simulation.world, config.workspace.box()), config) as simulation:
        for collection in run.collections:
            simulation.go_to(collection.start)
            collection.observe(simulation.pose, simulation.velocity, simulation.image())
            while not (collection.complete or collection.exhausted):
                command = collection.next_command()
                simulation.move(command.velocity, command.duration)
                collection.observe(simulation.pose, simulation.velocity, simulation.image())
    return run.finish()


def load_config(path: Path) -> Config:
    """The configuration of a session."""
    return Session.open_read_only(path).config


def centres(sets: Sequence[FingerprintSet]) -> None:
    """Print how far each centre is from the object it is of."""
    print(
        "\n| session | updates | objects found / there | blanks | centre errors [cm] |\n| --- | --- | --- | --- | --- |"
    )
    for found in sets:
        truth = true_objects(found.config)
        objects = [item for item in found.fingerprints if item.kind != BLANK]
        errors = ", ".join(f"{100.0 * away:.2f} ({kind})" for kind, away in (nearest(o.centre, truth) for o in objects))
        blanks = len(found.fingerprints) - len(objects)
        print(f"| {found.session} | {found.updates} | {len(objects)} / {len(truth)} | {blanks} | {errors} |")
    print(flush=True)


def stream(name: str, condition: str, count: int, folder: Path) -> Tuple[np.ndarray, np.ndarray]:
    """States (N, 3) and images (N, H, W, 3) of an even coverage of a world under a condition."""
    path = folder / f"{name}-{condition}-{count}.npz"
    if not path.exists():
        np.savez(path, **dict(zip(("states", "images"), record(name, condition, count))))
    with np.load(path, allow_pickle=False) as stored:
        return stored["states"], stored["images"]


def record(name: str, condition: str, count: int) -> Tuple[np.ndarray, np.ndarray]:
    """Explore a world."""
    config = Config()
    exploration = replace(config.exploration, explorer="uniform_ergodic", seed=STREAM_SEED, steps=count)
    config = replace(config, exploration=exploration, simulation=replace(config.simulation, world=name))
    world = changed(load_world(name, config.workspace.box()), condition)
    states, images = [], []
    with Simulation(world, config) as simulation:
        run = ExplorationRun(config)
        while run.step < count:
            states.append(simulation.pose)
            images.append(simulation.image())
            run.observe(simulation.pose, simulation.velocity)
            run.assess(None)
            command = run.next_command()
            simulation.move(command.velocity, command.duration)
    images_ = np.array(images)
    if condition == "brightness":
        images_ = np.rint(BRIGHTNESS * images_).astype(np.uint8)
    return np.array(states), images_


def changed(world: World, condition: str) -> World:
    """The world under a condition."""
    if condition == "noise":
        return replace(world, disturbances=Disturbances(image_noise=NOISE))
    if condition == "texture":
        return replace(world, table=replace(world.table, texture=world.table.texture.parent / TEXTURE))
    return world


def evaluate(
    sets: Sequence[FingerprintSet], world: str, condition: str, features: str, states: np.ndarray, images: np.ndarray
) -> Iterator[Outcome]:
    """Look for every fingerprint and score each rule."""
    config = Config(simulation=replace(Config().simulation, world=world))
    settings = IdentificationConfig(features=features)
    box = config.workspace.box()
    identification = Identification(sets, box, config.camera, settings)
    identification.observe(states, images)
    verified = identification.decide(states, images)
    truth = true_scene(config, sets)
    for item in identification.targets:
        key = (item.session, item.fingerprint.name)
        instances = sum(kind == truth.kinds[key] for kind, _, _ in truth.objects)
        rules = {
            RANKED: ranked(item, settings, instances),
            "belief > 0.5": [d for d in peaks(item, settings) if d.belief_mean > 0.5],
            "verified": verified,
        }
        for rule, decisions in rules.items():
            yield outcome(condition, features, rule, world, decisions, replace(truth, kinds={key: truth.kinds[key]}))


def outcome(
    condition: str,
    features: str,
    rule: str,
    world: str,
    decisions: Sequence[Decision],
    truth: Truth,
) -> Outcome:
    """The score of one fingerprint under one rule; a blank is one instance."""
    ((session, name), kind), *_ = truth.kinds.items()
    hits, instances, errors, false = score(decisions, truth)
    claims = sum((d.session, d.fingerprint) == (session, name) and d.found for d in decisions)
    if kind == BLANK:
        hits, instances = int(claims > 0 and not false), 1
    absent = int(instances == 0)
    return Outcome(
        condition,
        features,
        rule,
        world,
        session,
        kind or "?",
        hits,
        instances,
        false,
        absent * int(claims > 0),
        absent,
        tuple(errors),
    )


def peaks(item: SearchTarget, settings: IdentificationConfig) -> List[Decision]:
    """The peaks of a belief as claims, the highest first."""
    own = item.session, item.fingerprint.name, item.fingerprint.kind
    found = item.grid.peaks(settings.separation, settings.candidates)
    return [Decision(*own, FOUND, 0, peak.pose, 0.0, 0.0, 0.0, 0, peak.mean, peak.std, "") for peak in found]


def ranked(item: SearchTarget, settings: IdentificationConfig, instances: int) -> List[Decision]:
    """Return as many of the highest peaks as there are instances of the kind, or one for a blank."""
    return peaks(item, settings)[: 1 if item.fingerprint.kind == BLANK else instances]


def report(outcomes: Sequence[Outcome], worlds: Sequence[str]) -> None:
    """Print hits by kind, location errors and false claims, for every condition, features and rule."""
    print("\nown workspaces first, then test workspaces; hits / instances; errors of the hits in cm")
    print(
        "| where | condition | features | rule | duck | plant | star | blank | objects | median error | largest |",
        end="",
    )
    print(" absent kinds claimed | false claims |\n|" + " --- |" * 13)
    for where in ("own", "test"):
        chosen = [o for o in outcomes if (o.world in worlds) == (where == "test")]
        for key in dict.fromkeys((o.condition, o.features, o.rule) for o in chosen):
            rows = [o for o in chosen if (o.condition, o.features, o.rule) == key]
            cells = [share(rows, (kind,)) for kind in ("duck", "plant", "star", BLANK)]
            objects = [o for o in rows if o.kind != BLANK]
            errors = [100.0 * error for o in objects for error in o.errors]
            median, largest = (f"{f(errors):.2f}" if errors else "-" for f in (np.median, np.max))
            absent, claimed = sum(o.absent for o in objects), sum(o.absent_false for o in objects)
            false = sum(o.claims_false for o in objects)
            cells += [share(rows, ("duck", "plant", "star")), median, largest, f"{claimed} / {absent}", str(false)]
            print(f"| {where} | {' | '.join(key)} | {' | '.join(cells)} |")
    print(f"\na hit lies within {100 * SAME_PLACE:g} cm of an instance", flush=True)


def share(rows: Sequence[Outcome], kinds: Sequence[str]) -> str:
    """Hits of some kinds over their instances."""
    chosen = [o for o in rows if o.kind in kinds]
    hits, instances = sum(o.hits for o in chosen), sum(o.instances for o in chosen)
    return f"{hits} / {instances}" if instances else "-"


if __name__ == "__main__":
    main()
