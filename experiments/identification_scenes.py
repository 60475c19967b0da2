"""Scenes for the evaluation of identification, how a decision is judged in them, and tables of the results.

A scene holds two objects that one session learned, at new places and yaws, and two unknown ones. Everything about it
is drawn from its condition and number. Unknown objects are random_urdfs/000 to /499 of pybullet_data and tables have
seeds below 5000; reserved scenes have /500 to /999 and other seeds.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Callable, Dict, Mapping, NamedTuple, Sequence, Tuple

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.errors import WorldError
from embodied_active_learning.evaluation.identification_tables import (
    ALL,
    NO_OBJECT,
    OTHER_TABLE,
    group_by,
    of_objects,
    outcome_table,
)
from embodied_active_learning.evaluation.result_tables import Rows
from embodied_active_learning.objects.decision import UNDECIDED, Decision
from embodied_active_learning.objects.fingerprint import BLANK
from embodied_active_learning.objects.scoring import Truth, score
from embodied_active_learning.simulation.disturbance import Disturbance
from embodied_active_learning.simulation.placed_objects import PlacedObject
from embodied_active_learning.simulation.random_world import random_world
from embodied_active_learning.simulation.scene import Scene
from embodied_active_learning.simulation.table_textures import TEXTURE_KINDS
from embodied_active_learning.simulation.truth import objects_of
from embodied_active_learning.simulation.world import World, build_world
from embodied_active_learning.simulation.world_settings import Disturbances, GeneratedTexture

LEARNED_TABLE, CLOSE_OBJECTS = "learned table", "9 cm apart"
OBJECTS, UNKNOWN_OBJECTS, SPACING, CLOSE = 2, 2, 0.12, 0.09
EXPOSURE, SPEED = 0.02, 0.15  # s, m/s: a blur of 3 mm, or 3.4 px
_RESERVED_FROM = 500  # number of the first reserved procedural object


def _relit(world: World, **values: Any) -> World:
    return replace(world, lighting=replace(world.lighting, **values))


_CHANGES: Dict[str, Callable[[World, np.random.Generator], World]] = {
    "brightness": lambda world, random: _relit(world, brightness=round(random.uniform(0.5, 1.5), 3)),
    "gradient": lambda world, random: _relit(
        world, gradient=2.0, gradient_direction=round(random.uniform(0.0, 6.28), 3)
    ),
    "shadow": lambda world, _: _relit(world, shadow=0.4, shadow_centre=(0.475, 0.0), shadow_radius=0.08),
    "white balance": lambda world, random: _relit(
        world, white_balance=tuple(np.round(random.uniform(0.88, 1.12, 3), 3))
    ),
    "noise": lambda world, _: replace(world, disturbances=Disturbances(image_noise=10.0)),
    "motion blur": lambda world, _: _relit(world, motion_blur=EXPOSURE),
}
"""What a condition changes in a scene. ALL makes all changes in this order: another one would draw other scenes."""
CONDITIONS = (LEARNED_TABLE, OTHER_TABLE[0], *_CHANGES, CLOSE_OBJECTS, ALL)


class Place(NamedTuple):
    """A scene: its world, and the session that learned its table ("" if none did)."""

    condition: str
    number: int
    world: World
    learned_by: str


@dataclass(frozen=True)
class Row:
    """How one fingerprint fared in one scene under one rule."""

    condition: str
    scene: int
    rule: str
    session: str
    fingerprint: str
    kind: str
    own_table: int
    present: int
    hit: int
    false_claim: int
    undecided: int
    error: float  # m, of a hit
    reason: str


class Scenes:
    """Draws scenes with the objects and on the tables of some sessions."""

    def __init__(self, worlds: Mapping[str, World], config: Config, reserved: bool = False) -> None:
        """Use the worlds of sessions by name, and the camera and workspace of a configuration."""
        self._worlds = {name: world for name, world in worlds.items() if world.objects}
        self._config = config
        self._box = config.workspace.box()
        self._reserved = reserved
        learned = {item.model.urdf.stem for world in worlds.values() for item in world.objects}
        first = _RESERVED_FROM if reserved else 0
        numbers = (f"{number:03d}" for number in range(first, first + _RESERVED_FROM))
        self._unknown = [f"random_urdfs/{number}" for number in numbers if number not in learned]

    def draw(self, condition: str, number: int) -> Place:
        """Build a scene."""
        seed = zlib.crc32(f"{condition} {number} {self._reserved}".encode())
        random = np.random.default_rng(seed)
        spacing = CLOSE if condition in (CLOSE_OBJECTS, ALL) else SPACING
        table = GeneratedTexture(
            TEXTURE_KINDS[number % len(TEXTURE_KINDS)], (5000 if self._reserved else 1000) + seed % 1000
        )
        while True:
            kinds = [str(name) for name in random.choice(self._unknown, UNKNOWN_OBJECTS, replace=False)]
            count, world_seed = OBJECTS + UNKNOWN_OBJECTS, int(random.integers(2**31))
            settings = random_world(world_seed, count, spacing, kinds=kinds, table=table)
            try:
                world = build_world(settings, self._box, Path("scene.yaml"))
                return self._changed(world, condition, number, random)
            except WorldError:  # an object as high as the camera, or objects that overlap
                continue

    def _changed(self, world: World, condition: str, number: int, random: np.random.Generator) -> Place:
        """Put objects of one session in place of the first ones, and change table and light."""
        session = sorted(self._worlds)[int(random.integers(len(self._worlds)))]
        own = self._worlds[session]
        chosen = random.choice(len(own.objects), OBJECTS, replace=len(own.objects) < OBJECTS)
        objects = [_moved(own.objects[index], place) for index, place in zip(chosen, world.objects)]
        changed = replace(world, objects=(*objects, *world.objects[OBJECTS:]))
        for name, change in _CHANGES.items():
            if condition in (name, ALL):
                changed = change(changed, random)
        if condition not in OTHER_TABLE:
            changed = replace(changed, table=own.table)
        Scene(changed, self._config.camera).close()
        return Place(condition, number, changed, "" if condition in OTHER_TABLE else session)


def _moved(item: PlacedObject, place: PlacedObject) -> PlacedObject:
    return replace(item, name=place.name, position=place.position, yaw=place.yaw)


def photograph(world: World, config: Config, count: int, seed: int) -> Tuple[np.ndarray, np.ndarray]:
    """Return states (N, 3) uniform over the workspace, and images (N, H, W, 3) uint8."""
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


def judge(decisions: Sequence[Decision], place: Place, rule: str, name: Tuple[str, str], kind: str) -> Row:
    """Compare the decisions of a rule about one fingerprint with the scene.

    Args:
        decisions: About this fingerprint.
        place: The scene.
        rule: Name of the rule.
        name: Session and name of the fingerprint.
        kind: Of the object that it shows, as `true_kinds` returns it.
    """
    scored = score(decisions, Truth(objects_of(place.world), {name: kind}))
    found = any(item.found for item in decisions)
    errors = [0.0] if kind == BLANK and found and not scored.false_claims else scored.errors
    return Row(
        condition=place.condition,
        scene=place.number,
        rule=rule,
        session=name[0],
        fingerprint=name[1],
        kind=kind or NO_OBJECT,
        own_table=int(place.learned_by == name[0]),
        present=int(kind == BLANK or scored.instances > 0),
        hit=int(bool(errors)),
        false_claim=int(scored.false_claims > 0),
        undecided=int(not found and any(item.outcome == UNDECIDED for item in decisions)),
        error=min(errors, default=float("nan")),
        reason=decisions[0].reason if decisions else "",
    )


def report(rows: Rows) -> None:
    """Print a table of each rule: every condition, all of them, fingerprints of no object, and blanks."""
    for rule, of_rule in group_by(rows, "rule").items():
        objects = of_objects(of_rule)
        groups = {
            **group_by(objects, "condition"),
            "all rows above": objects,
            "fingerprints of no object": [row for row in of_rule if row["kind"] == NO_OBJECT],
            "blanks": [row for row in of_rule if row["kind"] == BLANK],
        }
        print("", f"rule: {rule}", "", *outcome_table("condition", groups), sep="\n")
