"""Evaluate identification on random scenes: hits, false claims and undecided ones, for each change of table and light.

    source setup.bash && python3 experiments/identification.py SESSION_FOLDER ... --output FILE.csv [--scenes 3]

All fingerprints of the sessions are searched for in images from random states of identification_scenes.py. Rows are
appended to the file, so that an interrupted call continues. With --reserved, unknown objects and tables are those that
are kept for one final report: use that once, after all development.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict, replace
from functools import cached_property
from pathlib import Path
from typing import Iterator, List, Sequence, Tuple

import torch
from identification_baselines import BASELINES, Stream
from identification_scenes import CONDITIONS, Place, Row, Scenes, judge, photograph, report

from embodied_active_learning.config import BELIEF, FROM_BELIEF, LATENTS, PIXELS, IdentificationConfig
from embodied_active_learning.evaluation.table1 import keep_counted
from embodied_active_learning.objects.decision import Decision, decisions_about
from embodied_active_learning.objects.decision_rule import make_rule
from embodied_active_learning.objects.fingerprint import BLANK, OBJECT
from embodied_active_learning.objects.identification import Identification
from embodied_active_learning.objects.scene_views import ObservedScene
from embodied_active_learning.objects.scoring import true_kinds
from embodied_active_learning.session.fingerprints import load_fingerprints
from embodied_active_learning.simulation.truth import objects_of
from embodied_active_learning.simulation.world import World, load_world
from embodied_active_learning.sweep.csv_files import append_rows, read_rows

RANKED = "ranked (count known), our reading"
PAPER = {
    RANKED: {"decision": BELIEF, "min_belief": 0.0},
    "belief > 0.5": {"decision": BELIEF},
}
"""The paper does not state when a fingerprint counts as identified."""


def main() -> None:
    """Search all scenes and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sessions", nargs="+", type=Path)
    parser.add_argument("--output", required=True, type=Path, help="CSV file")
    parser.add_argument("--conditions", nargs="*", default=list(CONDITIONS), choices=CONDITIONS)
    parser.add_argument("--scenes", type=int, default=3, help="scenes of each condition")
    parser.add_argument("--first", type=int, default=0, help="number of the first scene")
    parser.add_argument("--images", type=int, default=300, help="images of each scene")
    parser.add_argument("--decision-only", action="store_true", help="without the paper's rules, which take most time")
    parser.add_argument("--baselines", nargs="*", default=[], choices=list(BASELINES))
    parser.add_argument("--error-rates", nargs="*", default=[], type=float, help="decide at these rates too")
    parser.add_argument("--reserved", action="store_true", help="use the reserved objects and tables")
    options = parser.parse_args()
    torch.set_num_threads(1)
    done = {(row["condition"], int(row["scene"])) for row in read_rows(options.output, missing_ok=True)}
    evaluation = Evaluation(
        options.sessions, options.baselines, options.error_rates, options.reserved, options.decision_only
    )
    for number in range(options.first, options.first + options.scenes):
        for condition in options.conditions:
            if (condition, number) not in done:
                rows = evaluation.run(evaluation.scenes.draw(condition, number), options.images)
                append_rows(options.output, map(asdict, rows))
                print(condition, number, flush=True)
    report(read_rows(options.output))


class Evaluation:
    """The fingerprints of some sessions, and the scenes in which they are searched for."""

    def __init__(
        self,
        sessions: Sequence[Path],
        baselines: Sequence[str] = (),
        error_rates: Sequence[float] = (),
        reserved: bool = False,
        decision_only: bool = False,
    ) -> None:
        """Load all fingerprints.

        Args:
            sessions: Folders.
            baselines: Names in BASELINES.
            error_rates: To decide at, beside the default one.
            reserved: Whether scenes have the reserved objects and tables.
            decision_only: Whether to leave out the rules that need beliefs.
        """
        self._settings = IdentificationConfig()
        self._error_rates, self._decision_only = error_rates, decision_only
        sets = [load_fingerprints(path) for path in sessions]
        self._sets = sets
        self.config = sets[0].config
        self._box = self.config.workspace.box()
        worlds = {item.session: load_world(item.config.simulation.world, self._box) for item in sets}
        self.scenes = Scenes(worlds, self.config, reserved)
        self.kinds = {
            (item.session, name): kind
            for item in sets
            for name, kind in true_kinds(item, objects_of(worlds[item.session])).items()
        }
        self.search = Identification(sets, self._box, self.config.camera, self._settings)
        self._baselines = {name: BASELINES[name](self.config.camera) for name in baselines}

    @cached_property
    def _search_by_pixels(self) -> Identification:
        """The search with beliefs from pixels, which few calls need."""
        settings = replace(self._settings, features=PIXELS)
        return Identification(self._sets, self._box, self.config.camera, settings)

    def run(self, place: Place, count: int) -> Iterator[Row]:
        """Search one scene in a number of images and judge each rule."""
        states, images = photograph(place.world, self.config, count, place.number)
        scene = ObservedScene(states, images, self.config.camera, self._box, self._settings.margin)
        for rule, decisions in self._decisions(Stream(states, images, scene.mosaic), scene, place.world):
            for name, kind in self.kinds.items():
                if rule in self._baselines and kind == BLANK:
                    continue  # they search for objects
                yield judge(decisions_about(decisions, *name), place, rule, name, kind)

    def _decisions(self, stream: Stream, scene: ObservedScene, world: World) -> Iterator[Tuple[str, List[Decision]]]:
        """The decisions of each rule."""
        self.search.reset()
        rates = {f"verified, error rate {rate:g}": rate for rate in self._error_rates}
        for name, rate in {"verified": self._settings.error_rate, **rates}.items():
            yield name, decide(self.search, replace(self._settings, error_rate=rate), scene)
        if not self._decision_only:
            yield from self._belief_decisions(stream, scene, world)
        objects = [item for item in self.search.targets if item.fingerprint.kind == OBJECT and not item.problem]
        for name, baseline in self._baselines.items():
            yield name, [baseline.decide(item, stream) for item in objects]

    def _belief_decisions(
        self, stream: Stream, scene: ObservedScene, world: World
    ) -> Iterator[Tuple[str, List[Decision]]]:
        """The decisions of each rule that uses beliefs."""
        for features, search in ((LATENTS, self.search), (PIXELS, self._search_by_pixels)):
            search.reset()
            search.observe(stream.states, stream.images)
            for name, changes in PAPER.items():
                decisions = decide(search, replace(self._settings, **changes), scene)
                if name == RANKED:
                    decisions = self._keep_counted(decisions, world)
                yield f"{name}, {features}", decisions
        from_belief = replace(self._settings, candidates_from=FROM_BELIEF)
        yield "verified, candidates of belief", decide(self.search, from_belief, scene)

    def _keep_counted(self, decisions: Sequence[Decision], world: World) -> List[Decision]:
        """Keep as many of the best beliefs of each fingerprint as there are objects of its kind."""
        kept = []
        for session in dict.fromkeys(session for session, _ in self.kinds):
            kinds = {name: kind for (other, name), kind in self.kinds.items() if other == session}
            kept += keep_counted(decisions, session, kinds, objects_of(world))
        return kept


def decide(search: Identification, settings: IdentificationConfig, scene: ObservedScene) -> List[Decision]:
    """Return the decisions about all fingerprints; those of one session exclude each other from a place."""
    decisions = []
    for name in dict.fromkeys(item.session for item in search.targets):
        group = [item for item in search.targets if item.session == name]
        results = make_rule(settings).decide(group, scene, closed={})
        decisions += [decision for result in results for decision in result.decisions]
    return decisions


if __name__ == "__main__":
    main()
