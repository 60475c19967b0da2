"""Evaluate identification on random scenes: hits, false claims and undecided ones, for each change of table and light.

    source setup.bash && python3 experiments/identification.py SESSION_FOLDER ... --output FOLDER [--scenes 4]

A scene holds two objects that were learned by any of the sessions, at new places and yaws, and two unknown ones. All
fingerprints are searched for in images from random states. Rows are appended to results.csv, so that an interrupted
call continues. The unknown objects are random_urdfs/000 to /499 of pybullet_data; with --reserved they are /500 to
/999, and tables come from other seeds: use that once, after all development.
"""

from __future__ import annotations

import argparse
import csv
import zlib
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, Dict, Iterator, List, Sequence, Tuple

import numpy as np
import torch

from embodied_active_learning.config import Config, IdentificationConfig
from embodied_active_learning.errors import WorldError
from embodied_active_learning.objects.decision import Decision, decisions_about
from embodied_active_learning.objects.decision_rule import DecisionRule
from embodied_active_learning.objects.fingerprint import BLANK, FingerprintSet
from embodied_active_learning.objects.identification import Identification
from embodied_active_learning.objects.report import SAME_PLACE, nearest
from embodied_active_learning.objects.scene_views import Mosaic, SceneViews
from embodied_active_learning.objects.search_target import SearchTarget
from embodied_active_learning.session.fingerprints import load_fingerprints
from embodied_active_learning.simulation.disturbance import Disturbance
from embodied_active_learning.simulation.placed_objects import PlacedObject
from embodied_active_learning.simulation.random_world import random_world
from embodied_active_learning.simulation.scene import Scene
from embodied_active_learning.simulation.table_textures import TEXTURE_KINDS
from embodied_active_learning.simulation.world import World, build_world, load_world
from embodied_active_learning.simulation.world_settings import Disturbances, GeneratedTexture, Lighting

CONDITIONS = (
    "learned table", "other table", "brightness", "gradient", "shadow", "white balance", "noise", "motion blur",
    "9 cm apart", "all",
)  # fmt: skip
BASELINES = {
    "ranked (count known), our reading": {"decision": "belief", "min_belief": 0.0},
    "belief > 0.5": {"decision": "belief"},
}
"""The paper does not state when a fingerprint counts as identified."""
OBJECTS, UNKNOWN_OBJECTS, SPACING, CLOSE = 2, 2, 0.12, 0.09
EXPOSURE, SPEED = 0.02, 0.15  # s, m/s: a blur of 3 mm, or 3.4 px
_RESAMPLES = 2000


@dataclass(frozen=True)
class Row:
    """How one fingerprint fared in one scene under one rule."""

    condition: str
    scene: int
    rule: str
    session: str
    fingerprint: str
    kind: str
    present: int
    hit: int
    false_claim: int
    undecided: int
    error: float  # m, of a hit
    reason: str


def main() -> None:
    """Search all scenes and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sessions", nargs="+", type=Path)
    parser.add_argument("--output", required=True, type=Path)
    parser.add_argument("--conditions", nargs="*", default=list(CONDITIONS), choices=CONDITIONS)
    parser.add_argument("--scenes", type=int, default=4, help="scenes of each condition")
    parser.add_argument("--images", type=int, default=400, help="images of each scene")
    parser.add_argument("--reserved", action="store_true", help="use the reserved objects and tables")
    parser.add_argument("--error-rate", type=float, default=IdentificationConfig().error_rate)
    options = parser.parse_args()
    torch.set_num_threads(1)
    options.output.mkdir(parents=True, exist_ok=True)
    path = options.output / "results.csv"
    done = {(row["condition"], int(row["scene"])) for row in read(path)}
    evaluation = Evaluation(options.sessions, options.error_rate)
    for condition in options.conditions:
        for scene in range(options.scenes):
            if (condition, scene) not in done:
                append(path, list(evaluation.run(condition, scene, options.images, options.reserved)))
                print(condition, scene, flush=True)
    report(read(path))


class Evaluation:
    """The fingerprints of some sessions, and the objects that they learned."""

    def __init__(self, sessions: Sequence[Path], error_rate: float) -> None:
        """Load all fingerprints."""
        settings = IdentificationConfig(error_rate=error_rate)
        self._settings = settings
        self._sets = [load_fingerprints(path) for path in sessions]
        self.config = self._sets[0].config
        self._box = self.config.workspace.box()
        self._worlds = {item.session: load_world(item.config.simulation.world, self._box) for item in self._sets}
        pairs = {item.kind: item for world in self._worlds.values() for item in world.objects}
        self._learned = [pairs[kind] for kind in sorted(pairs)]
        self.kinds = {key: kind for item in self._sets for key, kind in self._true_kinds(item)}
        self.search = Identification(self._sets, self._box, self.config.camera, settings)
        pixels = replace(settings, features="pixels")
        self._by_pixels = Identification(self._sets, self._box, self.config.camera, pixels)

    def run(self, condition: str, scene: int, count: int, reserved: bool) -> Iterator[Row]:
        """Search one scene and judge each rule."""
        world = self.world(condition, scene, reserved)
        states, images = photograph(world, self.config, count, scene)
        views = SceneViews(states, images, self.config.camera)
        mosaic = Mosaic(views, self._box, self._settings.margin)
        for name, decisions in self._decisions(states, images, views, mosaic, world):
            for (session, fingerprint), kind in self.kinds.items():
                about = decisions_about(decisions, session, fingerprint)
                yield judge(about, world, kind, (condition, scene, name, session, fingerprint))

    def _decisions(
        self, states: np.ndarray, images: np.ndarray, views: SceneViews, mosaic: Mosaic, world: World
    ) -> Iterator[Tuple[str, List[Decision]]]:
        """The decisions of each rule."""
        for features, search in (("latents", self.search), ("pixels", self._by_pixels)):
            search.reset()
            search.observe(states, images)
            rules = {f"{name}, {features}": replace(self._settings, **changes) for name, changes in BASELINES.items()}
            if features == "latents":
                rules["verified"] = self._settings
                rules["verified, candidates of belief"] = replace(self._settings, candidates_from="belief")
            for name, settings in rules.items():
                decisions = []
                for group in by_session(search.targets):
                    decisions += DecisionRule(settings).decide(group, views, mosaic)
                yield name, self._counted(decisions, world) if "ranked" in name else decisions

    def _counted(self, decisions: Sequence[Decision], world: World) -> List[Decision]:
        """As many of the highest peaks of each fingerprint as there are instances; one of a blank."""
        kept: List[Decision] = []
        for (session, fingerprint), kind in self.kinds.items():
            about = sorted(decisions_about(decisions, session, fingerprint), key=lambda item: -item.belief_mean)
            count = 1 if kind == BLANK else sum(item.kind == kind for item in world.objects)
            kept += about[:count]
        return kept

    def _true_kinds(self, found: FingerprintSet) -> Iterator[Tuple[Tuple[str, str], str]]:
        """Each fingerprint with the kind of the object at its centre, BLANK, or "" for no object."""
        objects = locations(self._worlds[found.session])
        for item in found.fingerprints:
            kind, distance = nearest(item.centre, objects)
            at_object = distance <= SAME_PLACE
            yield (found.session, item.name), (BLANK if item.kind == BLANK else kind if at_object else "")

    def world(self, condition: str, scene: int, reserved: bool) -> World:
        """Build a scene; all is drawn from its number and condition."""
        seed = zlib.crc32(f"{condition} {scene} {reserved}".encode())
        random = np.random.default_rng(seed)
        numbers = range(500, 1000) if reserved else range(500)
        unknown = [name for name in (f"random_urdfs/{number:03d}" for number in numbers) if not self._is_learned(name)]
        close = condition in ("9 cm apart", "all")
        table = GeneratedTexture(TEXTURE_KINDS[scene % len(TEXTURE_KINDS)], (5000 if reserved else 1000) + seed % 1000)
        while True:
            kinds = [str(name) for name in random.choice(unknown, 2, replace=False)]
            spacing = CLOSE if close else SPACING
            count = OBJECTS + UNKNOWN_OBJECTS
            settings = random_world(int(random.integers(2**31)), count, spacing, kinds=kinds, table=table)
            try:
                world = build_world(settings, self._box, Path("scene.yaml"))
                return self._changed(world, condition, random)
            except WorldError:  # an object as high as the camera, or objects that overlap
                continue

    def _changed(self, world: World, condition: str, random: np.random.Generator) -> World:
        """Put learned objects in place of the first ones, and change table and light."""
        chosen = random.choice(len(self._learned), OBJECTS, replace=False)
        objects = [self._moved(index, place) for index, place in zip(chosen, world.objects)]
        changed = replace(world, objects=(*objects, *world.objects[OBJECTS:]), lighting=lighting(condition, random))
        if condition in ("noise", "all"):
            changed = replace(changed, disturbances=Disturbances(image_noise=10.0))
        if condition not in ("other table", "all"):
            tables = [item.table for item in self._worlds.values()]
            changed = replace(changed, table=tables[int(random.integers(len(tables)))])
        Scene(changed, self.config.camera).close()
        return changed

    def _moved(self, index: int, place: PlacedObject) -> PlacedObject:
        return replace(self._learned[index], name=place.name, position=place.position, yaw=place.yaw)

    def _is_learned(self, name: str) -> bool:
        return any(item.model.urdf.stem == Path(name).name for item in self._learned)


def lighting(condition: str, random: np.random.Generator) -> Lighting:
    """Draw the light of a condition."""
    values: Dict[str, object] = {}
    if condition in ("brightness", "all"):
        values["brightness"] = round(random.uniform(0.5, 1.5), 3)
    if condition in ("gradient", "all"):
        values.update(gradient=2.0, gradient_direction=round(random.uniform(0.0, 6.28), 3))
    if condition in ("shadow", "all"):
        values.update(shadow=0.4, shadow_centre=(0.475, 0.0), shadow_radius=0.08)
    if condition in ("white balance", "all"):
        values["white_balance"] = tuple(np.round(random.uniform(0.88, 1.12, 3), 3))
    if condition in ("motion blur", "all"):
        values["motion_blur"] = EXPOSURE
    return Lighting(**values)  # type: ignore[arg-type]


def photograph(world: World, config: Config, count: int, seed: int) -> Tuple[np.ndarray, np.ndarray]:
    """States (N, 3) uniform over the workspace, and images (N, H, W, 3) uint8."""
    random, box = np.random.default_rng([7, seed]), config.workspace.box()
    states = random.uniform(box.lower, box.upper, (count, box.size))
    disturbance, scene = Disturbance(world.disturbances, seed), Scene(world, config.camera)
    images = []
    for index, state in enumerate(states):
        direction = random.uniform(-np.pi, np.pi)
        velocity = (SPEED * np.cos(direction), SPEED * np.sin(direction), 0.0)
        images.append(disturbance.image(scene.render(state, config.camera.distance, velocity), 0.2 * index))
    scene.close()
    return states, np.stack(images)


def by_session(targets: Sequence[SearchTarget]) -> List[List[SearchTarget]]:
    """The targets of each session."""
    return [[item for item in targets if item.session == name] for name in dict.fromkeys(t.session for t in targets)]


def locations(world: World) -> List[Tuple[str, float, float]]:
    """Kind and position of each object."""
    return [(item.kind, item.position[0], item.position[1]) for item in world.objects]


def judge(decisions: Sequence[Decision], world: World, kind: str, key: Tuple[str, int, str, str, str]) -> Row:
    """Compare the decisions about one fingerprint with the scene."""
    objects = locations(world)
    instances = [item for item in objects if item[0] == kind]
    found = [item for item in decisions if item.found]
    if kind == BLANK:
        false = any(nearest(item.pose, objects)[1] <= SAME_PLACE for item in found)
        hit, error = bool(found) and not false, 0.0
    else:
        false = any(nearest(item.pose, instances)[1] > SAME_PLACE for item in found)
        error = min((nearest(item.pose, instances)[1] for item in found), default=np.inf)
        hit = error <= SAME_PLACE
    undecided = not found and any(item.outcome == "undecided" for item in decisions)
    present = kind == BLANK or bool(instances)
    reason = decisions[0].reason if decisions else ""
    error = float(error) if hit else float("nan")
    return Row(*key, kind or "?", int(present), int(hit), int(false), int(undecided), error, reason)


def append(path: Path, rows: Sequence[Any]) -> None:
    """Append rows to a CSV file."""
    new = not path.exists()
    with path.open("a", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, [field.name for field in fields(rows[0])])
        if new:
            writer.writeheader()
        writer.writerows(asdict(row) for row in rows)


def read(path: Path) -> List[Dict[str, str]]:
    """Read the rows of a CSV file; none if there is no such file."""
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def report(rows: Sequence[Dict[str, str]]) -> None:
    """Print hits, false claims and undecided shares with intervals over sessions, and location errors."""
    print("\n| condition | rule | hits | undecided, present | false claims, absent | undecided, absent | error [cm] |")
    print("| --- " * 7 + "|")
    for kinds in ("objects", "blanks"):
        of_kind = [row for row in rows if (row["kind"] == BLANK) == (kinds == "blanks")]
        for condition in dict.fromkeys(row["condition"] for row in of_kind):
            for rule in dict.fromkeys(row["rule"] for row in of_kind):
                chosen = [row for row in of_kind if (row["condition"], row["rule"]) == (condition, rule)]
                there = [row for row in chosen if row["present"] == "1"]
                absent = [row for row in chosen if row["present"] == "0"]
                errors = [100.0 * float(row["error"]) for row in there if row["hit"] == "1" and kinds == "objects"]
                cells = (share(there, "hit"), share(there, "undecided"), share(absent, "false_claim"))
                error = f"{np.median(errors):.2f}" if errors else "-"
                print(
                    f"| {condition} ({kinds}) | {rule} | {' | '.join(cells)} | {share(absent, 'undecided')} | {error} |"
                )


def share(rows: Sequence[Dict[str, str]], field: str) -> str:
    """A count with the 95 % bootstrap interval of its share, resampled over sessions."""
    if not rows:
        return "-"
    sessions = sorted({row["session"] for row in rows})
    values = [[int(row[field]) for row in rows if row["session"] == name] for name in sessions]
    counts = np.array([[sum(part), len(part)] for part in values])
    drawn = counts[np.random.default_rng(0).integers(len(sessions), size=(_RESAMPLES, len(sessions)))].sum(axis=1)
    low, high = np.quantile(drawn[:, 0] / drawn[:, 1], (0.025, 0.975))
    return f"{counts[:, 0].sum()} / {counts[:, 1].sum()} ({100 * low:.0f}-{100 * high:.0f} %)"


if __name__ == "__main__":
    main()
