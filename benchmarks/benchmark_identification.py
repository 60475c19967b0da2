#!/usr/bin/env python3
"""Measure identification: images per second compared with a naive variant, and sixty fingerprints of twenty models.

    source setup.bash && python3 benchmarks/benchmark_identification.py

Models have random weights, and images show discs on a noisy table, all in the paper's sizes.
The fast and the plain way take turns in one process: other load on the machine meets both alike. Trust the ratio first.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Callable, Dict, List, NamedTuple

import numpy as np
import torch
from measuring import Row, Section, Turn, resident_memory, row, run, timed

from embodied_active_learning.config import Config, IdentificationConfig
from embodied_active_learning.geometry import table_points, transform_poses, wrap
from embodied_active_learning.model.cvae import ConditionalVAE
from embodied_active_learning.model.trained_model import TrainedModel
from embodied_active_learning.objects.appearance import Appearance
from embodied_active_learning.objects.beliefs import BeliefGrid, EvidenceWeights
from embodied_active_learning.objects.calibration import calibrate
from embodied_active_learning.objects.fingerprint import BLANK, OBJECT, Fingerprint, FingerprintSet
from embodied_active_learning.objects.identification import Identification
from embodied_active_learning.objects.matching import Matcher
from embodied_active_learning.session.fingerprints import load_fingerprints, save_fingerprints
from embodied_active_learning.session.session import Session

CENTRES = ((0.42, -0.06, 0.3), (0.55, 0.05, -0.5), (0.40, 0.08, 0.0))  # m, m, rad; the last one is a blank
VIEWS = 50
FULL_STREAM = 2000  # images
STREAM_PART = 64  # images that the identifier processes at a time
NAIVE_PART = 4

SETTINGS = IdentificationConfig()
TABLE, OBJECT_COLOURS, OBJECT_RADIUS = (170, 165, 150), ((200, 40, 30), (40, 70, 200)), 0.03  # grey levels, m
NOISE = 8.0  # grey levels


class Stream(NamedTuple):
    """Images (N, H, W, 3) uint8 and their camera states (N, 3) [m, m, rad]."""

    states: np.ndarray
    images: np.ndarray

    def part(self, begin: int, end: int) -> Stream:
        """Return the images from an index up to another."""
        return Stream(self.states[begin:end], self.images[begin:end])


class NaiveIdentification:
    """Naive variant: encode each image once for every stored view, and update every grid cell one image at a time."""

    def __init__(self, found: FingerprintSet) -> None:
        config, workspace = found.config, found.config.workspace.box()
        self._workspace = workspace
        self.network = ConditionalVAE((config.camera.height, config.camera.width), workspace.size, config.model)
        self.network.load_state_dict(found.weights)
        self.network.eval().requires_grad_(False)
        self._fingerprints = found.fingerprints
        self._matcher = Matcher(TrainedModel(config, found.weights), found.fingerprints, SETTINGS)
        self._weights = EvidenceWeights(SETTINGS)
        self._axes = BeliefGrid(workspace, SETTINGS)
        prior = np.full(SETTINGS.cells, 0.5)  # information, 1 / variance
        self._sums = [(prior.copy(), 0.5 * prior) for _ in found.fingerprints]

    def observe(self, states: np.ndarray, images: np.ndarray) -> None:
        """Process the next images of the stream."""
        for state, image, weight in zip(states, images, self._weights.update(states)):
            for index, item in enumerate(self._fingerprints):
                distances = np.linalg.norm(self._latents(item.states, image) - item.latent_means, axis=1)
                view = int(distances.argmin())
                pose = transform_poses(item.centre, item.states[view], state)
                self._update(index, pose, float(self._matcher.value(distances[view])), weight)

    def mean(self, index: int) -> np.ndarray:
        """Return the belief (nx, ny, nyaw) of a fingerprint."""
        information, weighted = self._sums[index]
        return weighted / information

    def _latents(self, states: np.ndarray, image: np.ndarray) -> np.ndarray:
        with torch.inference_mode():
            normalised = torch.from_numpy(self._workspace.normalise(states).astype(np.float32))
            repeated = torch.from_numpy(image).expand(len(states), *image.shape)
            return self.network.encode(normalised, repeated).mean.numpy()

    def _update(self, index: int, pose: np.ndarray, value: float, weight: float) -> None:
        grid, (information, weighted) = self._axes, self._sums[index]
        full = grid.x[0] <= pose[0] <= grid.x[-1] and grid.y[0] <= pose[1] <= grid.y[-1]
        scales = (SETTINGS.kernel_std, SETTINGS.kernel_std, SETTINGS.kernel_yaw_std)
        away = (grid.x - pose[0], grid.y - pose[1], wrap(grid.yaw - pose[2]))
        energies = [0.5 * np.square(distance / std) for distance, std in zip(away, scales)]
        along = [np.exp(full * energy.min() - energy) for energy in energies]
        footprint = np.multiply.outer(np.multiply.outer(along[0], along[1]), along[2])
        far = SETTINGS.near_variance / SETTINGS.far_pull
        added = weight / (far + footprint * (SETTINGS.near_variance - far))
        information += added
        weighted += added * value


def make_stream(config: Config, count: int, seed: int = 0) -> Stream:
    """Discs at the centres of the objects, seen from all over the workspace."""
    random, box = np.random.default_rng(seed), config.workspace.box()
    states = random.uniform(box.lower, box.upper, (count, 3))
    return Stream(states, make_images(config, states, random))


def make_images(config: Config, states: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Images (N, H, W, 3) uint8 of the discs on a noisy table, from states (N, 3)."""
    camera = config.camera
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width]
    points = table_points(states[:, None, None], rows, columns, camera)
    images = np.empty((*points.shape[:-1], 3))
    images[:] = TABLE
    for centre, colour in zip(CENTRES, OBJECT_COLOURS):
        images[np.hypot(*np.moveaxis(points - centre[:2], -1, 0)) < OBJECT_RADIUS] = colour
    return np.clip(images + NOISE * random.standard_normal(images.shape), 0, 255).astype(np.uint8)


def make_set(config: Config, seed: int = 0) -> FingerprintSet:
    """A random model, and views of two discs and of a blank place."""
    torch.manual_seed(seed)
    weights = ConditionalVAE((config.camera.height, config.camera.width), 3, config.model).state_dict()
    model, random, fingerprints = TrainedModel(config, weights), np.random.default_rng(seed), []
    for number, centre in enumerate(CENTRES):
        states = config.workspace.box().clip(random.normal(centre, (0.01, 0.01, 0.8), (VIEWS, 3)))
        images = make_images(config, states, random)
        kind = BLANK if number == len(CENTRES) - 1 else OBJECT
        name, latents = f"{kind}-{number + 1}", model.encode(states, images)
        fingerprints.append(Fingerprint(name, kind, np.array(centre), states, images, *latents, 0.0))
    calibrated = [
        replace(item, calibration=calibrate(Appearance(item, fingerprints, config.camera), config.fingerprint.trials))
        if item.kind == OBJECT
        else item
        for item in fingerprints
    ]
    return FingerprintSet(config.session.name, 9000, 3000, "2026-11-22T12:45:00Z", config, weights, tuple(calibrated))


def make_identification(sets: List[FingerprintSet]) -> Identification:
    """Return an identification of all fingerprints of the sets."""
    config = sets[0].config
    return Identification(sets, config.workspace.box(), config.camera, SETTINGS)


def rate_section(config: Config, rounds: int) -> Section:
    """Measure one image with three fingerprints of one model, in both variants, and compare their beliefs."""
    found = make_set(config)
    fast, naive = make_identification([found]), NaiveIdentification(found)
    stream = make_stream(config, (rounds + 1) * STREAM_PART)
    turns: Dict[str, List[Turn]] = {"naive": [], "fast": []}
    for index in range(rounds + 1):
        part = stream.part(index * STREAM_PART, (index + 1) * STREAM_PART)
        turns["naive"].append(_an_image(naive.observe, part.part(0, NAIVE_PART)))
        turns["fast"].append(_an_image(fast.observe, part))
    naive_turns, fast_turns = turns["naive"][1:], turns["fast"][1:]  # the first round warms up
    rows = [row("naive: encode each image for every view", naive_turns)]
    rows.append(row("identifier", fast_turns, naive_turns, "100 images/s"))
    rows[-1].value = f"{1e3 / rows[-1].wall:.0f} images/s"
    how = (
        f"Three fingerprints of {VIEWS} views of one model; time of one image. Largest difference between the beliefs:"
        f" {_difference(found, stream):.0e}."
    )
    return Section("Identification: one model", how, rows)


def many_section(config: Config, models: int, images: int) -> Section:
    """Measure three fingerprints of each of many models, from reading their files to the decisions."""
    sets: List[FingerprintSet] = []
    with tempfile.TemporaryDirectory() as root:
        folder = _store_set(replace(config, session=replace(config.session, root=root)))
        # Read once per model, so that each has its own memory.
        for index in range(models):
            sets.append(replace(load_fingerprints(folder), session=f"session-{index}"))
        reading = timed(lambda: load_fingerprints(folder)).wall * models
    searches: List[Identification] = []
    construction = timed(lambda: searches.append(make_identification(sets))).wall
    stream = make_stream(config, images)
    observing = timed(lambda: _observe(searches[0], stream)).wall / images
    deciding = timed(lambda: searches[0].decide(*stream)).wall
    whole = (reading + construction + deciding + observing * FULL_STREAM) / 1e3
    measured = "" if images == FULL_STREAM else f", extrapolated from {images} images"
    rows = [
        Row("reading the files", reading),
        Row("construction", construction),
        Row("one image", observing),
        Row("deciding", deciding),
        Row("whole", value=f"{whole:.0f} s for {FULL_STREAM} images{measured}", target="60 s"),
        Row("resident memory", value=f"{resident_memory():.0f} MiB"),
    ]
    how = f"{len(searches[0].targets)} fingerprints of {models} models; their calibration is stored."
    return Section("Identification: many models", how, rows)


def _observe(searches: Identification, stream: Stream) -> None:
    """Process a stream in parts of the identifier's size."""
    for begin in range(0, len(stream.states), STREAM_PART):
        searches.observe(*stream.part(begin, begin + STREAM_PART))


def _store_set(config: Config) -> Path:
    """Store a session with fingerprints only. Return its folder."""
    with Session.open_for_writing(config) as session:
        save_fingerprints(session.paths.path, make_set(config))
        return session.paths.path


def _difference(found: FingerprintSet, stream: Stream) -> float:
    fast, naive = make_identification([found]), NaiveIdentification(found)
    for one in (fast, naive):
        one.observe(*stream.part(0, NAIVE_PART))
    return max(float(np.abs(item.grid.mean - naive.mean(index)).max()) for index, item in enumerate(fast.targets))


def _an_image(observe: Callable[[np.ndarray, np.ndarray], None], stream: Stream) -> Turn:
    """Return the time of one image of a stream."""
    turn, count = timed(lambda: observe(*stream)), len(stream.states)
    return Turn(turn.wall / count, turn.cpu / count, turn.faults // count)


def measure(arguments: argparse.Namespace) -> List[Section]:
    """Return both sections."""
    if arguments.threads:
        torch.set_num_threads(arguments.threads)
    config = Config.from_dict({"session": {"name": "benchmark"}})
    return [rate_section(config, arguments.rounds), many_section(config, arguments.models, arguments.images)]


if __name__ == "__main__":
    run(__doc__, measure, threads=0, rounds=8, models=20, images=200)
