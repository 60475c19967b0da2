"""A painted table: images of two-coloured discs from any state, and an ideal model of some of them."""

from __future__ import annotations

from typing import Dict, NamedTuple, Sequence, Tuple

import numpy as np
import torch

from embodied_active_learning.config import CameraConfig, Config
from embodied_active_learning.geometry import intrinsics, optical_rotation
from embodied_active_learning.objects.fingerprint import BLANK, OBJECT, Fingerprint, FingerprintSet

TABLE = (150, 140, 130)
# Colours of each kind: of the disc, and of its half on the side of its x axis.
KINDS = (
    ((210, 30, 30), (250, 200, 40)),
    ((30, 60, 210), (60, 220, 220)),
    ((20, 120, 40), (150, 240, 120)),
    ((15, 15, 15), (235, 235, 235)),
)


class Thing(NamedTuple):
    """A painted disc."""

    kind: int
    pose: Tuple[float, float, float]  # m, m, rad
    radius: float = 0.02  # m
    height: float = 0.0  # m


def seen_points(states, camera):
    """Return the table point (N, H, W, 2) [m] of every pixel, from camera matrix and orientation."""
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width]
    rays = np.stack((columns, rows, np.ones_like(rows)), axis=-1) * camera.distance
    rays = rays @ np.linalg.inv(intrinsics(camera.width, camera.height, camera.field_of_view)).T
    turns = np.array([optical_rotation(state[2]) for state in states]).reshape(-1, 3, 3)
    return (rays @ turns[:, None, :2].transpose(0, 1, 3, 2)) + np.reshape(states, (-1, 3))[:, None, None, :2]


def paint(states, things: Sequence[Thing], camera: CameraConfig, noise=3.0, seed=0):
    """Return images (N, H, W, 3) uint8 of things from states (N, 3); noise: standard deviation [grey levels]."""
    random = np.random.default_rng(seed)
    parts = np.array_split(np.asarray(states).reshape(-1, 3), 1 + len(states) // 64)
    return np.concatenate([_paint(part, things, camera, noise, random) for part in parts])


def _paint(states, things, camera, noise, random):
    images = np.empty((len(states), camera.height, camera.width, 3), np.float32)
    images[:] = TABLE
    images += noise * random.standard_normal(images.shape, np.float32)
    points = seen_points(states, camera)
    for thing in things:
        scale = camera.distance / (camera.distance - thing.height)
        poses = np.tile(thing.pose, (len(states), 1))
        poses[:, :2] += (scale - 1.0) * (poses[:, :2] - states[:, :2])
        _cover(images, points, thing._replace(radius=scale * thing.radius), poses)
    return np.clip(np.rint(images), 0, 255).astype(np.uint8)


def _cover(images, points, thing, poses):
    """Paint a thing into images with the given table points, at one pose (N, 3) per image."""
    across, along = np.moveaxis(points - poses[:, None, None, :2], -1, 0)
    inside = across**2 + along**2 < thing.radius**2
    towards = across * np.cos(poses[:, 2])[:, None, None] + along * np.sin(poses[:, 2])[:, None, None]
    images[inside] = KINDS[thing.kind][0]
    images[inside & (towards > 0.0)] = KINDS[thing.kind][1]
    return inside


def random_states(workspace, count, seed=0):
    """Return states (N, 3) [m, m, rad] across a workspace."""
    return np.random.default_rng(seed).uniform(workspace.lower, workspace.upper, (count, 3))


class PaintedModel:
    """Stands in for a well trained TrainedModel on a painted table.

    A latent encodes which thing is in view (or table, or an unknown thing) and its pose if the image was taken at the
    given state. The decoder paints the thing near its learned pose, in slightly different colours, and predicts a
    large standard deviation elsewhere.
    """

    IMPERFECTION = 20.0  # colour error of reconstructions, grey levels
    SURE, FAIR, UNSURE = 0.01, 0.08, 0.3  # predicted standard deviations of table, thing, and anything unknown
    _IDENTITY, _PLACE, _TURN = 6.0, 0.012, 4.0  # latent distance between things; m and 1/rad per unit of a latent
    _KNOWN_RADIUS = 0.08  # m around a learned pose within which the decoder is certain
    _MAX_SHIFT = (0.006, 0.006, 0.25)  # m, m, rad: from the learned pose in a reconstruction

    def __init__(self, config: Config, weights: Dict[str, torch.Tensor]) -> None:
        self.camera, self.workspace = config.camera, config.workspace.box()
        self.known = [Thing(int(row[0]), tuple(row[1:4]), row[4]) for row in weights["things"].tolist()]
        self.latent_size = latents_for(len(self.known))
        self.encoded = 0

    def image_features(self, images):
        """(N, 4): index of the largest thing in view, and its pose in the camera frame [m, m, rad]."""
        self.encoded += len(images)
        points = seen_points(np.zeros((1, 3)), self.camera)[0]
        return np.array([self._features(codes, points) for codes in _codes(images)], np.float32).reshape(-1, 4)

    def encode(self, states, images):
        return self.encode_features(states, self.image_features(images))

    def encode_features(self, states, features):
        index, latents = features[:, 0].astype(int), np.zeros((len(states), self.latent_size), np.float32)
        latents[np.arange(len(states)), index] = self._IDENTITY
        cosine, sine = np.cos(states[:, 2]), np.sin(states[:, 2])
        x = states[:, 0] + cosine * features[:, 1] - sine * features[:, 2]
        y = states[:, 1] + sine * features[:, 1] + cosine * features[:, 2]
        pose = np.stack((x, y, states[:, 2] + features[:, 3]), axis=1)
        for number, thing in enumerate(self.known):
            dx, dy, turn = (pose[index == number] - thing.pose).T
            place = (dx / self._PLACE, dy / self._PLACE, self._TURN * (np.cos(turn) - 1.0), self._TURN * np.sin(turn))
            latents[index == number, -4:] = np.stack(place, axis=1)
        return latents, np.full_like(latents, 0.1)

    def encode_pairs(self, states, features):
        pairs = [self.encode_features(states, np.repeat(one[None], len(states), axis=0))[0] for one in features]
        return np.stack(pairs)

    def decode(self, latents, states):
        table = len(self.known)
        index, std = latents[:, : table + 2].argmax(axis=1), np.full(len(states), self.UNSURE)
        std[index == table] = self.SURE
        images = np.empty((len(states), self.camera.height, self.camera.width, 3), np.float32)
        images[:] = TABLE
        points = seen_points(states, self.camera)
        for number, thing in enumerate(self.known):
            rows = np.flatnonzero(index == number)
            own = images[rows]
            inside = _cover(own, points[rows], thing, self._encoded_poses(thing, latents[rows]))
            own[inside] += self.IMPERFECTION
            images[rows] = own
            std[rows[np.hypot(*(states[rows, :2] - thing.pose[:2]).T) < self._KNOWN_RADIUS]] = self.FAIR
        return np.clip(images / 255.0, 0.0, 1.0), std.astype(np.float32)

    def _encoded_poses(self, thing, latents):
        """Poses (N, 3) of a thing encoded in latents, clipped to near its learned pose."""
        x, y, cosine, sine = latents[:, -4:].T
        turn = np.arctan2(sine, cosine + self._TURN)
        change = np.stack((self._PLACE * x, self._PLACE * y, turn), axis=1)
        return thing.pose + np.clip(change, np.negative(self._MAX_SHIFT), self._MAX_SHIFT)

    def _features(self, codes, points):
        sides = [[codes == _code(colour) for colour in KINDS[thing.kind]] for thing in self.known]
        room = [np.sum(both) for both in sides]
        unknown = np.isin(codes, _CODES).sum() - sum(room)
        if max([*room, unknown]) < 5:
            return len(self.known), 0.0, 0.0, 0.0
        if unknown > max(room, default=0):
            return len(self.known) + 1, 0.0, 0.0, 0.0
        index = int(np.argmax(room))
        plain, marked = sides[index]
        middle = points[plain | marked].mean(axis=0)
        towards = (points[marked].mean(axis=0) if marked.any() else middle) - middle
        return index, middle[0], middle[1], np.arctan2(towards[1], towards[0])


def _codes(images):
    """Return one number (N, H, W) per colour."""
    return images.astype(np.int32) @ np.array([65536, 256, 1], np.int32)


def _code(colour):
    return int(_codes(np.array(colour)))


_CODES = [_code(colour) for colours in KINDS for colour in colours]


def latents_for(things: int) -> int:
    """Return the number of latents of a PaintedModel with a number of things."""
    return things + 6


def weights_of(things: Sequence[Thing]) -> Dict[str, torch.Tensor]:
    """Return the weights of a PaintedModel of these things."""
    rows = [[thing.kind, *thing.pose, thing.radius] for thing in things]
    return {"things": torch.tensor(rows, dtype=torch.float64).reshape(-1, 5)}


def learn(things: Sequence[Thing], blank=None, session="learned", views=50, **sections) -> FingerprintSet:
    """Return the fingerprints of a painted table: object-1, object-2, ... and blank-1 around a place (2,)."""
    values = {
        "camera": {"width": 45, "height": 45},
        "model": {"latent_size": latents_for(len(things))},
        # Most things have no height. With 19 trials, the smallest error rate is the default one.
        "fingerprint": {"prints": True, "trials": 19},
    }
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
