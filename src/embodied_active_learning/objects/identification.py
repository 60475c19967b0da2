"""CheckResult fingerprints again: a stream of images goes in, beliefs and decisions come out (paper, Sec. 5)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import List, Sequence, Tuple

import numpy as np

from embodied_active_learning.config import CameraConfig, IdentificationConfig
from embodied_active_learning.errors import ConfigError, CorruptFileError
from embodied_active_learning.geometry import pose_distance
from embodied_active_learning.model.trained_model import TrainedModel
from embodied_active_learning.objects.beliefs import BeliefGrid, EvidenceWeights, Peak
from embodied_active_learning.objects.fingerprint import BLANK, Fingerprint, FingerprintSet
from embodied_active_learning.objects.matching import Matcher, Matches
from embodied_active_learning.objects.verification import Comparison, Verifier
from embodied_active_learning.workspace import Workspace

_SAME_CAMERA = ("width", "height", "field_of_view", "distance")
_CHUNK = 64
_YAWS = 3
"""Yaws that are tried at each peak, the most believed first."""


@dataclass(frozen=True)
class Decision:
    """One place where a fingerprint's object was found; or, when it was not, the place where it fitted best."""

    session: str
    fingerprint: str
    kind: str
    found: bool
    instance: int  # 1, 2, ... of those found; 0 when not found
    pose: np.ndarray  # (3,) m, m, rad
    confidence: float  # share of the compared views that agree, 0 to 1; 0 when they are too few
    residual: float  # grey levels of 1, median over the views; infinite where none was compared
    views: int  # of the candidate, from near and usable places
    belief_mean: float
    belief_std: float
    reason: str  # for a person


class SearchTarget:
    """One fingerprint that is being looked for."""

    def __init__(
        self, found: FingerprintSet, fingerprint: Fingerprint, threshold: float, grid: BeliefGrid, verifier: Verifier
    ) -> None:
        """threshold: the distance at which a measurement says neither yes nor no."""
        self.session = found.session
        self.fingerprint = fingerprint
        self.threshold = threshold
        self.grid = grid
        self.verifier = verifier
        self._parts: List[Matches] = []

    @property
    def trace(self) -> Matches:
        """What each image so far has said about it."""
        if not self._parts:
            return Matches(np.empty(0, np.int32), np.empty(0, np.float32), np.empty(0, np.float32), np.empty((0, 3)))
        if len(self._parts) > 1:
            names = ("view", "distance", "value", "pose")
            joined = Matches(*(np.concatenate([getattr(part, name) for part in self._parts]) for name in names))
            self._parts = [joined]
        return self._parts[0]

    def own(self, decisions: Sequence[Decision]) -> List[Decision]:
        """Those of the decisions that are about this fingerprint."""
        key = self.session, self.fingerprint.name
        return [decision for decision in decisions if (decision.session, decision.fingerprint) == key]

    def observe(self, matches: Matches, weights: np.ndarray) -> None:
        """Take what N images say, with the weight (N,) of each."""
        self._parts.append(matches)
        self.grid.update(matches.pose, matches.value, weights)


class Identification:
    """Looks for the fingerprints of any number of sessions, each with its own model, in one stream of images."""

    def __init__(
        self,
        sets: Sequence[FingerprintSet],
        workspace: Workspace,
        camera: CameraConfig,
        settings: IdentificationConfig,
    ) -> None:
        """workspace, camera: those of the stream.

        Raises ConfigError when a model was trained with another camera, CorruptFileError when it is damaged.
        """
        self._settings = settings
        self._weights = EvidenceWeights(settings)
        self._groups: List[Tuple[Matcher, List[SearchTarget]]] = []
        self.images = 0
        for found in sets:
            _check_camera(found, camera)
            if not found.fingerprints:
                continue
            model = _model(found)
            matcher = Matcher(model, found.fingerprints, settings)
            sought = []
            for item in found.fingerprints:
                grid, verifier = BeliefGrid(workspace, settings), Verifier(model, item, found.config, settings)
                sought.append(SearchTarget(found, item, matcher.threshold, grid, verifier))
            self._groups.append((matcher, sought))

    @property
    def sought(self) -> List[SearchTarget]:
        """Every fingerprint that is looked for, by session."""
        return [item for _, group in self._groups for item in group]

    def observe(self, states: np.ndarray, images: np.ndarray) -> None:
        """Take the next N images (N, H, W, 3) uint8 of the stream, from states (N, 3) [m, m, rad]."""
        for begin in range(0, len(states), _CHUNK):
            part = slice(begin, begin + _CHUNK)
            weights = self._weights.of(states[part])
            for matcher, sought in self._groups:
                for item, matches in zip(sought, matcher.match(states[part], images[part])):
                    item.observe(matches, weights)
            self.images += len(states[part])

    def decide(self, states: np.ndarray, images: np.ndarray) -> List[Decision]:
        """Decide for every fingerprint, from the beliefs and from the stream's states (N, 3) and images.

        A fingerprint is found at each candidate, that is, peak of its belief, whose views agree with it. Where several
        objects of one model claim the same place, the one that more of the views agree with has it.
        """
        decisions: List[Decision] = []
        for _, group in self._groups:
            candidates = [self._candidates(item, states, images) for item in group]
            winners = self._winners([candidate for of_one in candidates for candidate in of_one])
            for of_one in candidates:
                decisions += _numbered([_settled(candidate, winners) for candidate in of_one])
        return decisions

    def _winners(self, candidates: Sequence[Decision]) -> List[Tuple[Decision, Decision]]:
        """Each found candidate with the one that has its place: itself, or a better one close by of the same kind."""
        by_belief = self._settings.decision == "belief"
        accepted: List[Decision] = []
        winners: List[Tuple[Decision, Decision]] = []
        found = [candidate for candidate in candidates if candidate.found]
        for candidate in sorted(found, key=lambda item: -(item.belief_mean if by_belief else item.confidence)):
            rivals = (
                other
                for other in accepted
                if other.kind == candidate.kind
                and other.fingerprint != candidate.fingerprint
                and pose_distance(candidate.pose, other.pose)[0] < self._settings.separation
            )
            winner = next(rivals, candidate)
            winners.append((candidate, winner))
            if winner is candidate:
                accepted.append(candidate)
        return winners

    def _candidates(self, item: SearchTarget, states: np.ndarray, images: np.ndarray) -> List[Decision]:
        """Every peak of a belief, the highest first, decided on its own."""
        peaks = item.grid.peaks(self._settings.separation, self._settings.candidates)
        return [self._candidate(item, peak, states, images) for peak in peaks]

    def _candidate(self, item: SearchTarget, peak: Peak, states: np.ndarray, images: np.ndarray) -> Decision:
        """The decision at a peak, at the most believed yaw that the views agree with.

        An object may look much the same from two sides; at the wrong one, views are explained badly, or the camera
        could not have been there.
        """
        if item.fingerprint.kind == BLANK:
            # It looks the same from all sides; its own yaw makes every view usable.
            pose = np.array([*peak.pose[:2], item.fingerprint.centre[2]])
            return self._at(item, peak, pose, states, images)
        tried: List[Decision] = []
        for yaw in item.grid.yaws(peak.pose, _YAWS):
            pose = _refined(np.array([*peak.pose[:2], yaw]), item.trace)
            tried.append(self._at(item, peak, pose, states, images))
            if tried[-1].found:
                break
        return max(tried, key=lambda decision: (decision.found, decision.confidence))

    def _at(self, item: SearchTarget, peak: Peak, pose: np.ndarray, states: np.ndarray, images: np.ndarray) -> Decision:
        """The decision at a pose (3,) next to a peak."""
        settings = self._settings
        views = item.verifier.views(pose, states)
        pointing = self._pointing(item, views, pose)
        rises = item.fingerprint.kind == BLANK or peak.rise >= settings.min_prominence
        enough = len(views) >= settings.min_views and pointing.mean() >= settings.min_agreement
        if settings.decision == "verified" and rises and enough:
            comparison = item.verifier.compare(pose, states, images)
        else:
            comparison = Comparison(views, np.full(len(views), np.inf))  # whatever they look like: spare the decoder
        agreeing = pointing & self._alike(comparison)
        found, reason = self._judge(peak, rises, pointing, agreeing)
        return Decision(
            session=item.session,
            fingerprint=item.fingerprint.name,
            kind=item.fingerprint.kind,
            found=found,
            instance=0,
            pose=pose,
            confidence=float(agreeing.mean()) if len(agreeing) >= settings.min_views else 0.0,
            residual=comparison.typical,
            views=len(agreeing),
            belief_mean=peak.mean,
            belief_std=peak.std,
            reason=reason,
        )

    def _pointing(self, item: SearchTarget, views: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Which of the views (V,) by themselves place the object at the candidate pose; a blank is in no place."""
        if item.fingerprint.kind == BLANK or not len(views):
            return np.ones(len(views), dtype=bool)
        distance, _ = pose_distance(item.trace.pose[views], pose)
        return distance <= self._settings.agreement_distance

    def _alike(self, comparison: Comparison) -> np.ndarray:
        """Which of the views (V,) look like the fingerprint's own: neither worse explained nor much better."""
        return np.abs(comparison.residual) <= self._settings.residual_limit

    def _judge(self, peak: Peak, rises: bool, pointing: np.ndarray, agreeing: np.ndarray) -> Tuple[bool, str]:
        """Whether the fingerprint is found, from the belief and its views (V,); and why, for a person."""
        settings, views = self._settings, len(agreeing)
        if settings.decision == "belief":
            found = peak.mean > settings.min_belief
            return found, f"belief {peak.mean:.2f} {'above' if found else 'not above'} {settings.min_belief:g}"
        if views < settings.min_views:
            return False, f"seen from {views} places only, {settings.min_views} are needed"
        if not rises:
            return False, f"belief {peak.rise:.3f} above its median only, {settings.min_prominence:g} are needed"
        if pointing.mean() < settings.min_agreement:
            return False, f"{pointing.sum()} of {views} views point here"
        return bool(agreeing.mean() >= settings.min_agreement), f"{agreeing.sum()} of {views} views agree"


def _settled(candidate: Decision, winners: Sequence[Tuple[Decision, Decision]]) -> Decision:
    """The candidate, or why another fingerprint of the same model has its place."""
    for other, winner in winners:
        if other is candidate and winner is not candidate:
            return replace(candidate, found=False, reason=f"{winner.fingerprint} fits better there")
    return candidate


def _refined(peak: np.ndarray, trace: Matches, distance: float = 0.02, turn: float = 0.5) -> np.ndarray:
    """The mean of the poses (3,) that images point to next to a peak: finer than the grid's cells."""
    away, turned = pose_distance(trace.pose, peak)
    near = (away < distance) & (turned < turn)
    if not near.any():
        return peak
    weights = trace.value[near] / trace.value[near].sum()
    x, y = weights @ trace.pose[near, :2]
    yaw = trace.pose[near, 2]
    return np.array([x, y, np.arctan2(weights @ np.sin(yaw), weights @ np.cos(yaw))])


def _numbered(candidates: Sequence[Decision]) -> List[Decision]:
    """The found ones by number, or the best one that was not. Of a blank, which is everywhere, one is enough."""
    found = [candidate for candidate in candidates if candidate.found]
    if not found:
        return sorted(candidates, key=lambda candidate: (-candidate.confidence, -candidate.belief_mean))[:1]
    if found[0].kind == BLANK:
        found = found[:1]
    return [replace(candidate, instance=number) for number, candidate in enumerate(found, start=1)]


def _model(found: FingerprintSet) -> TrainedModel:
    try:
        return TrainedModel(found.config, found.weights)
    except RuntimeError as error:
        raise CorruptFileError(
            f"the model of session {found.session}'s fingerprints does not fit the session's camera and model settings "
            f"({' '.join(str(error).split())}): call /fingerprint again"
        ) from error


def _check_camera(found: FingerprintSet, camera: CameraConfig) -> None:
    for name in _SAME_CAMERA:
        trained, given = getattr(found.config.camera, name), getattr(camera, name)
        if trained != given:
            raise ConfigError(
                f"session {found.session} was trained with camera/{name} = {trained}, the images have {given}: "
                "its fingerprints cannot be compared with them"
            )
