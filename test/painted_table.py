"""A painted table: discs of two colours, photographed from any state, and a model that has learned some of them."""

from __future__ import annotations

from typing import Dict, NamedTuple, Sequence, Tuple

import numpy as np
import torch

from embodied_active_learning.config import CameraConfig, Config
from embodied_active_learning.objects.fingerprint import BLANK, OBJECT, Fingerprint, FingerprintSet
from embodied_active_learning.simulation.scene import intrinsics, optical_rotation

TABLE = (150, 140, 130)
# What there is to be painted: the colour of the disc, and that of its half on the side of its own x.
KINDS = (
    ((210, 30, 30), (250, 200, 40)),
    ((30, 60, 210), (60, 220, 220)),
    ((20, 120, 40), (150, 240, 120)),
)


class Thing(NamedTuple):
    """A painted disc."""

    kind: int
    pose: Tuple[float, float, float]  # m, m, rad
    radius: float = 0.02  # m


def seen_points(states, camera):
    """The point of the table (N, H, W, 2) [m] in every pixel, by the camera matrix and the camera's orientation."""
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width]
    rays = np.stack((columns, rows, np.ones_like(rows)), axis=-1) * camera.distance
    rays = rays @ np.linalg.inv(intrinsics(camera.width, camera.height, camera.field_of_view)).T
    turns = np.stack([optical_rotation(state[2]) for state in states])
    return np.einsum("nij,hwj->nhwi", turns, rays)[..., :2] + np.asarray(states)[:, None, None, :2]


def paint(states, things: Sequence[Thing], camera: CameraConfig, noise=3.0, seed=0):
    """Photographs (N, H, W, 3) uint8 of the things from states (N, 3); noise: of the table, grey levels."""
    random = np.random.default_rng(seed)
    return np.concatenate(
        [_paint(part, things, camera, noise, random) for part in np.array_split(states, 1 + len(states) // 64)]
    )


def _paint(states, things, camera, noise, random):
    shape = (len(states), camera.height, camera.width, 3)
    if not len(states):
        return np.empty(shape, np.uint8)
    images = np.array(TABLE, np.float32) + noise * random.standard_normal(shape, np.float32)
    points = seen_points(states, camera)
    for thing in things:
        x, y, yaw = thing.pose
        away = points - (x, y)
        inside = np.hypot(away[..., 0], away[..., 1]) < thing.radius
        images[inside] = KINDS[thing.kind][0]
        images[inside & (away @ (np.cos(yaw), np.sin(yaw)) > 0.0)] = KINDS[thing.kind][1]
    return np.clip(np.rint(images), 0, 255).astype(np.uint8)


def random_states(workspace, count, seed=0):
    """States (N, 3) all over a workspace, m, m, rad."""
    return np.random.default_rng(seed).uniform(workspace.lower, workspace.upper, (count, 3))


class PaintedModel:
    """What a well trained model would answer on a painted table, in place of a LearnedModel.

    It knows some things where they stood when it learned. A latent says which one is in view, or the bare table, or
    something strange; and where that stands, if the image was taken where the encoder is told. The decoder paints the
    thing about where it stood, not quite in its colours, and is unsure where the thing does not belong.
    """

    IMPERFECTION = 20.0  # grey levels
    SURE, FAIR, UNSURE = 0.01, 0.08, 0.3  # predicted standard deviations of the table, a thing, and what is not known
    _IDENTITY = 4.0
    _PLACE = 0.012  # m
    _BELONGS = 0.08  # m
    _GIVES_WAY = (0.006, 0.006, 0.25)  # m, m, rad: farthest that a thing is painted from where it stood

    def __init__(self, config: Config, weights: Dict[str, torch.Tensor]) -> None:
        self.camera, self.workspace = config.camera, config.workspace.box()
        self.known = [Thing(int(row[0]), tuple(row[1:4]), row[4]) for row in weights["things"].tolist()]
        self.latent_size = latents_for(len(self.known))
        self.encoded = 0

    def image_features(self, images):
        """(N, 3 + F): index of the thing that takes most room, how it lies in the camera's frame."""
        self.encoded += len(images)
        points = seen_points(np.zeros((1, 3)), self.camera)[0]
        return np.stack([self._features(image.astype(np.int32), points) for image in images]).astype(np.float32)

    def encode(self, states, images):
        return self.encode_features(states, self.image_features(images))

    def encode_features(self, states, features):
        index, identities = features[:, 0].astype(int), len(self.known) + 2
        latents = np.zeros((len(states), self.latent_size), np.float32)
        latents[np.arange(len(states)), index] = self._IDENTITY
        cosine, sine = np.cos(states[:, 2]), np.sin(states[:, 2])
        x = states[:, 0] + cosine * features[:, 1] - sine * features[:, 2] - self.workspace.centre[0]
        y = states[:, 1] + sine * features[:, 1] + cosine * features[:, 2] - self.workspace.centre[1]
        yaw = states[:, 2] + features[:, 3]
        place = np.stack((x / self._PLACE, y / self._PLACE, np.cos(yaw), np.sin(yaw)), axis=1)
        latents[:, identities:] = place * (index < len(self.known))[:, None]
        return latents, np.full_like(latents, 0.1)

    def encode_pairs(self, states, features):
        pairs = [self.encode_features(states, np.repeat(one[None], len(states), axis=0))[0] for one in features]
        return np.stack(pairs)

    def decode(self, latents, states):
        table, images, std = len(self.known), [], np.full(len(states), self.UNSURE)
        index = latents[:, : table + 2].argmax(axis=1)
        std[index == table] = self.SURE
        for number, (latent, state) in enumerate(zip(latents, states)):
            thing = self._remembered(latent, index[number]) if index[number] < table else None
            image = paint(state[None], [thing] if thing else [], self.camera, noise=0.0)[0] / 255.0
            if thing:
                image += self.IMPERFECTION / 255.0 * np.any(image != np.array(TABLE) / 255.0, axis=-1, keepdims=True)
                if np.hypot(*(state[:2] - thing.pose[:2])) < self._BELONGS:
                    std[number] = self.FAIR
            images.append(image)
        return np.clip(images, 0.0, 1.0).astype(np.float32), std.astype(np.float32)

    def _remembered(self, latent, index):
        """The thing that a latent is of, about where it stood."""
        x, y, cosine, sine = latent[len(self.known) + 2 :]
        place = self.workspace.centre[:2] + self._PLACE * np.array([x, y])
        learned = np.array(self.known[index].pose)
        change = np.array([*place, np.arctan2(sine, cosine)]) - learned
        change[2] = np.arctan2(np.sin(change[2]), np.cos(change[2]))
        return self.known[index]._replace(
            pose=tuple(learned + np.clip(change, np.negative(self._GIVES_WAY), self._GIVES_WAY))
        )

    def _features(self, image, points):
        sides = [[np.abs(image - colour).sum(axis=-1) < 60 for colour in KINDS[thing.kind]] for thing in self.known]
        room = [np.sum(both) for both in sides]
        strange = (np.abs(image - TABLE).sum(axis=-1) > 90).sum() - sum(room)
        if max([*room, strange]) < 5:
            return len(self.known), 0.0, 0.0, 0.0
        if strange > max(room, default=0):
            return len(self.known) + 1, 0.0, 0.0, 0.0
        index = int(np.argmax(room))
        plain, marked = sides[index]
        middle = points[plain | marked].mean(axis=0)
        towards = (points[marked].mean(axis=0) if marked.any() else middle) - middle
        return index, middle[0], middle[1], np.arctan2(towards[1], towards[0])


def latents_for(things: int) -> int:
    """Latent variables of a PaintedModel of so many things."""
    return things + 6


def weights_of(things: Sequence[Thing]) -> Dict[str, torch.Tensor]:
    """The weights of a PaintedModel that knows these things."""
    rows = [[thing.kind, *thing.pose, thing.radius] for thing in things]
    return {"things": torch.tensor(rows, dtype=torch.float64).reshape(-1, 5)}


def learn(things: Sequence[Thing], blank=None, session="learned", views=50, **sections) -> FingerprintSet:
    """The fingerprints that a session has of a painted table: object-1, object-2, ... and blank-1 around a place (2,).

    Their views are of the whole table, as it was when it was learned.
    """
    values = {"camera": {"width": 45, "height": 45}, "model": {"latent_size": latents_for(len(things))}}
    config = Config.from_dict({**values, **sections})
    model, box = PaintedModel(config, weights_of(things)), config.workspace.box()
    centres = [(f"object-{number}", OBJECT, thing.pose) for number, thing in enumerate(things, start=1)]
    centres += [] if blank is None else [("blank-1", BLANK, (*blank, 0.0))]
    fingerprints = []
    for seed, (name, kind, pose) in enumerate(centres, start=1):
        random = np.random.default_rng(seed)
        places = random.normal(pose[:2], 0.015, (views, 2))
        states = box.clip(np.column_stack((places, random.uniform(box.lower[2], box.upper[2], views))))
        images = paint(states, things, config.camera, seed=seed)
        means, stds = model.encode(states, images)
        share = 0.3 if kind == OBJECT else 0.0
        fingerprints.append(Fingerprint(name, kind, np.array(pose), states, images, means, stds, share))
    return FingerprintSet(session, 9000, 3000, "2026-11-22T12:45:00Z", config, weights_of(things), tuple(fingerprints))
