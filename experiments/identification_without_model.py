#!/usr/bin/env python3
"""Evaluate the decision of identification without a model: fingerprints are drawn around the true places.

    source setup.bash && python3 experiments/identification_without_model.py --half tuning [--scenes 10]

For the development of the decision, which compares views and uses no latents. Fingerprints are of the shipped objects
and of random_urdfs/000 to /499, three on each of eight generated tables, with a centre that is wrong by up to 1.2 cm.
In a scene, the fingerprints of tables whose objects are there and of every fourth other table are searched for. The
halves `tuning` and `checking` share no table, no learned procedural object and no scene: look at the results of the
first one only while you change the rule.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Dict, List, Tuple

import numpy as np
from identification_scenes import (
    CONDITIONS,
    Place,
    Row,
    Scenes,
    judge,
    photograph,
    report,
)  # fmt: skip

from embodied_active_learning.config import Config, IdentificationConfig
from embodied_active_learning.model.cvae import ConditionalVAE
from embodied_active_learning.model.trained_model import TrainedModel
from embodied_active_learning.objects.beliefs import BeliefGrid
from embodied_active_learning.objects.collection import is_new_view
from embodied_active_learning.objects.decision import decisions_about
from embodied_active_learning.objects.decision_rule import make_rule
from embodied_active_learning.objects.fingerprint import BLANK, OBJECT, Fingerprint, FingerprintSet
from embodied_active_learning.objects.scene_views import ObservedScene
from embodied_active_learning.objects.scoring import nearest, true_kinds
from embodied_active_learning.objects.search_target import SearchTarget
from embodied_active_learning.simulation.random_world import SHIPPED, is_wide, random_world
from embodied_active_learning.simulation.scene import Scene
from embodied_active_learning.simulation.table_textures import TEXTURE_KINDS
from embodied_active_learning.simulation.truth import objects_of
from embodied_active_learning.simulation.world import World, build_world
from embodied_active_learning.simulation.world_settings import GeneratedTexture
from embodied_active_learning.sweep.csv_files import append_rows, read_rows

HALVES = {"tuning": 0, "checking": 1}
TABLES, OBJECTS = 8, 3
_ABSENT = 4  # every n-th table without objects in a scene is searched for
CENTRE_ERROR, MAX_ERROR = 0.005, 0.012  # m, standard deviation and limit of a centre's error


def main() -> None:
    """Search the scenes of one half and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--half", choices=list(HALVES), default="tuning")
    parser.add_argument(
        "--conditions", nargs="*", default=["learned table", "other table", "brightness", "all"], choices=CONDITIONS
    )
    parser.add_argument("--scenes", type=int, default=10, help="scenes of each condition")
    parser.add_argument("--images", type=int, default=300, help="images of each scene")
    parser.add_argument("--output", type=Path, help="CSV file to which rows are appended; scenes in it are skipped")
    options = parser.parse_args()
    rows = read_rows(options.output, missing_ok=True) if options.output else []
    done = {(row["condition"], int(row["scene"])) for row in rows}
    half = Half(options.half)
    for condition in options.conditions:
        for number in range(options.scenes):
            if (condition, half.scene_number(number)) not in done:
                place = half.scene(condition, number)
                found = half.search(place, *photograph(place.world, half.config, options.images, number))
                rows += [{name: str(value) for name, value in vars(row).items()} for row in found]
                if options.output:
                    append_rows(options.output, map(vars, found))
    report(rows)


class Half:
    """The fingerprints of one half, and its scenes."""

    def __init__(self, name: str) -> None:
        """Draw worlds and fingerprints."""
        self._half = HALVES[name]
        self.config = Config()
        self._box = self.config.workspace.box()
        self._settings = IdentificationConfig()
        camera = self.config.camera
        network = ConditionalVAE((camera.height, camera.width), self._box.size, self.config.model)
        self._untrained = TrainedModel(self.config, network.state_dict())
        self._worlds = {f"table-{index}": self._world(index) for index in range(TABLES)}
        self.sets = [self._learn(session, world) for session, world in self._worlds.items()]
        self.targets = [[self._target(item, one) for one in item.fingerprints] for item in self.sets]
        self._scenes = Scenes(self._worlds, self.config)
        self._kinds: Dict[Tuple[str, str], str] = {
            (item.session, name): kind
            for item in self.sets
            for name, kind in true_kinds(item, objects_of(self._worlds[item.session])).items()
        }

    def scene(self, condition: str, number: int) -> Place:
        """Return a scene by its number within the half."""
        return self._scenes.draw(condition, self.scene_number(number))

    def scene_number(self, number: int) -> int:
        """Return the number of a scene in the table, which counts the scenes of both halves."""
        return 2 * number + self._half

    def search(self, place: Place, states: np.ndarray, images: np.ndarray) -> List[Row]:
        """Decide about all fingerprints in images (N, H, W, 3) from states (N, 3), and judge the decisions."""
        scene = ObservedScene(states, images, self.config.camera, self._box, self._settings.margin)
        present = {item.kind for item in place.world.objects}
        rows: List[Row] = []
        for index, group in enumerate(self.targets):
            kinds = {
                (one.session, one.fingerprint.name): self._kinds[one.session, one.fingerprint.name] for one in group
            }
            if present & set(kinds.values()) or index % _ABSENT == place.number // 2 % _ABSENT:
                results = make_rule(self._settings).decide(group, scene, closed={})
                decisions = [decision for result in results for decision in result.decisions]
                rows += [
                    judge(decisions_about(decisions, *name), place, "verified", name, kind)
                    for name, kind in kinds.items()
                ]
        return rows

    def _target(self, found: FingerprintSet, fingerprint: Fingerprint) -> SearchTarget:
        """A target whose model and belief are not used."""
        grid = BeliefGrid(self._box, self._settings)
        return SearchTarget(found, fingerprint, self._untrained, 1.0, grid, self._settings.error_rate)

    def _world(self, index: int) -> World:
        """Three objects on a table."""
        number = 2 * index + self._half
        names = (f"random_urdfs/{one:03d}" for one in range(10 * number, 10 * number + 10))
        kinds = [*[name for name in names if is_wide(name)][: OBJECTS - 1], SHIPPED[index % len(SHIPPED)]]
        table = GeneratedTexture(TEXTURE_KINDS[index % len(TEXTURE_KINDS)], 2000 + number)
        world = build_world(random_world(number, 0, table=table), self._box, Path("world.yaml"))
        seed = 100 * number
        objects = []
        while len(objects) < len(kinds):  # one world of each kind, so that all of them are present
            one = build_world(random_world(seed, 1, kinds=[kinds[len(objects)]]), self._box, Path("w.yaml")).objects[0]
            seed += 1
            if all(np.hypot(*np.subtract(one.position[:2], other.position[:2])) > 0.11 for other in objects):
                objects.append(one)
        return World(world.name, tuple(objects), world.table)

    def _learn(self, session: str, world: World) -> FingerprintSet:
        """Fingerprints of all objects and of the barest place, without latents."""
        random = np.random.default_rng([self._half, int(session.split("-")[1])])
        scene = Scene(world, self.config.camera)
        free = random.uniform(self._box.lower[:2], self._box.upper[:2], (200, 2))
        barest = max(free, key=lambda one: nearest(one, objects_of(world))[1])
        fingerprints = []
        for index, item in enumerate(world.objects):
            error = np.clip(random.normal(0.0, CENTRE_ERROR, 2), -MAX_ERROR, MAX_ERROR)
            centre = np.array([*(np.array(item.position[:2]) + error), 0.0])
            fingerprints.append(self._fingerprint(f"object-{index + 1}", OBJECT, centre, scene, random))
        fingerprints.append(self._fingerprint("blank-1", BLANK, np.array([*barest, 0.0]), scene, random))
        scene.close()
        created = "2026-01-01T00:00:00Z"
        return FingerprintSet(session, 0, 0, created, self.config, {}, tuple(fingerprints))

    def _fingerprint(
        self, name: str, kind: str, centre: np.ndarray, scene: Scene, random: np.random.Generator
    ) -> Fingerprint:
        """Views with the density of a collection by the arm."""
        settings, states = self.config.fingerprint, np.empty((0, 3))
        while len(states) < settings.views:
            drawn = random.normal(centre, (settings.view_std, settings.view_std, settings.view_yaw_std))
            if self._box.contains(drawn) and is_new_view(drawn, states, settings):
                states = np.concatenate([states, drawn[None]])
        images = np.stack([scene.render(state, self.config.camera.distance) for state in states])
        latents: np.ndarray = np.zeros((len(states), self.config.model.latent_size), np.float32)
        return Fingerprint(name, kind, centre, states, images, latents, latents, 0.0)


if __name__ == "__main__":
    main()
