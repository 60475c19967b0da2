"""The rules that turn views and beliefs into decisions.

The paper does not state when a fingerprint counts as identified. The default rule (`identification/decision:
verified`) compares views of candidate places with the fingerprint's own views; its limits follow from these views and
one accepted error rate, see calibration. The alternative (`belief`) is a limit on the mean belief.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Dict, List, Mapping, NamedTuple, Sequence, Tuple

import numpy as np

from embodied_active_learning.config import BELIEF, FROM_BELIEF, IdentificationConfig
from embodied_active_learning.geometry import pose_distance, to_base_frame
from embodied_active_learning.objects.beliefs import Peak
from embodied_active_learning.objects.decision import FOUND, NOT_HERE, UNDECIDED, Decision
from embodied_active_learning.objects.fingerprint import BLANK
from embodied_active_learning.objects.limits import Limits
from embodied_active_learning.objects.matching import Matches
from embodied_active_learning.objects.pose_search import MIN_VIEWS, RefinedPose, propose, refine
from embodied_active_learning.objects.scene_views import Mosaic, ObservedScene, SceneViews
from embodied_active_learning.objects.search_target import SearchTarget
from embodied_active_learning.objects.similarity import NOT_SHOWN

_YAWS = 3
"""Yaws of a belief's peak from which the pose is searched, highest belief first."""
_REFINEMENT_DISTANCE = 0.02  # m
_REFINEMENT_TURN = 0.5  # rad
_CLEARLY_BELOW = 0.5
"""Factor of the miss limit below which an object is absent even if its views are few or distant."""
_MAX_TABLE_MATCH = 0.3
"""Share of the scene with the object's colours above which values just below the miss limit leave it open."""


class TargetResult(NamedTuple):
    """What is decided about a target.

    Attributes:
        target: The target.
        candidates: Decisions about its candidate places, without regard to other targets.
        decisions: Found instances, or one other decision.
        is_open: Whether more images may change the decisions.
        open_places: Places (2,) [m] about which more views may decide.
    """

    target: SearchTarget
    candidates: List[Decision]
    decisions: List[Decision]
    is_open: bool
    open_places: List[np.ndarray]


class DecisionRule(ABC):
    """Decides for the fingerprints of one model."""

    def __init__(self, settings: IdentificationConfig) -> None:
        """Use the limits of the settings."""
        self._settings = settings

    @abstractmethod
    def candidates(self, target: SearchTarget, scene: ObservedScene) -> List[Decision]:
        """Decide for each candidate place of a target, without regard to other targets."""

    @abstractmethod
    def is_open(self, target: SearchTarget, resolved: Sequence[Decision], scene: ObservedScene) -> bool:
        """Return whether more images may change what is decided about a target, given its resolved candidates."""

    @abstractmethod
    def open_places(self, target: SearchTarget, resolved: Sequence[Decision]) -> List[np.ndarray]:
        """Return the places (2,) [m] of a target's resolved candidates about which more views may decide."""

    @abstractmethod
    def rank(self, decision: Decision) -> float:
        """Return the position of a decision among those of one place: the lowest one wins."""

    def decide(
        self, targets: Sequence[SearchTarget], scene: ObservedScene, closed: Mapping[str, List[Decision]]
    ) -> List[TargetResult]:
        """Decide for every target. Of several objects at one place, the first one by rank is found there.

        Args:
            targets: Fingerprints of one model.
            scene: The images observed so far.
            closed: Candidates of targets by label, which are not evaluated again.
        """
        groups = [closed.get(target.label) or self.candidates(target, scene) for target in targets]
        results = []
        for target, group, resolved in zip(targets, groups, self._resolve(groups)):
            is_open = self.is_open(target, resolved, scene)
            places = self.open_places(target, resolved) if is_open else []
            results.append(TargetResult(target, group, _best_decisions(resolved), is_open, places))
        return results

    def _decision(self, target: SearchTarget, pose: np.ndarray, outcome: str, reason: str) -> Decision:
        """A decision at a pose without a comparison of views."""
        mean, std = target.grid.value_at(pose)
        return Decision(
            session=target.session,
            fingerprint=target.fingerprint.name,
            kind=target.fingerprint.kind,
            outcome=outcome,
            instance=0,
            pose=pose,
            confidence=0.0,
            error_rate=self._settings.error_rate,
            residual=np.inf,
            views=0,
            belief_mean=mean,
            belief_std=std,
            reason=reason,
        )

    def _resolve(self, groups: Sequence[Sequence[Decision]]) -> List[List[Decision]]:
        """Reject each found candidate of which a better one of another fingerprint was found at the same place."""
        accepted: List[Decision] = []
        rejected: Dict[int, Decision] = {}  # by the identity of the candidate that is replaced
        for candidate in sorted((item for group in groups for item in group if item.found), key=self.rank):
            winner = next((other for other in accepted if self._compete(candidate, other)), None)
            if winner is None:
                accepted.append(candidate)
            else:
                reason = f"{winner.fingerprint} is more similar there"
                rejected[id(candidate)] = replace(candidate, outcome=NOT_HERE, reason=reason)
        return [[rejected.get(id(item), item) for item in group] for group in groups]

    def _compete(self, one: Decision, other: Decision) -> bool:
        """Whether two different objects cannot both be where they were found."""
        near = pose_distance(one.pose, other.pose)[0] < self._settings.separation
        return bool(one.kind == other.kind and one.fingerprint != other.fingerprint and near)


class ViewRule(DecisionRule):
    """Compares views of candidate places with the fingerprint's own views (`identification/decision: verified`)."""

    def candidates(self, target: SearchTarget, scene: ObservedScene) -> List[Decision]:
        """Compare views of each candidate place, and decide by the limits of the similarity."""
        if target.fingerprint.kind == BLANK:
            return [self._blank(target, scene.mosaic)]
        if target.problem:
            pose = target.grid.peaks(self._settings.separation, 1)[0].pose
            return [self._decision(target, pose, UNDECIDED, target.problem)]
        settings, mosaic = self._settings, scene.mosaic
        places, table_match = propose(mosaic, target.appearance, settings.candidates)
        if settings.candidates_from == FROM_BELIEF:
            peaks = target.grid.peaks(settings.separation, settings.candidates)
            places = [_poses_at(target, peak) for peak in peaks]
        miss = target.calibration.limits(settings.error_rate).miss
        found = [
            refine(target.appearance, scene.views, starts, settings, mosaic.above(starts[0, :2]), miss)
            for starts in places
        ]
        decisions: List[Decision] = []
        for refined in sorted(found, key=lambda item: -item.similarity):
            middle = target.appearance.middle_at(refined.pose)
            if all(pose_distance(middle, other.pose)[0] >= settings.separation for other in decisions):
                decisions.append(self._judge(target, refined, scene, table_match))
        return decisions

    def is_open(self, target: SearchTarget, resolved: Sequence[Decision], scene: ObservedScene) -> bool:
        """Return whether neither an object was found nor its absence can be stated."""
        if any(candidate.found for candidate in resolved) or target.problem:
            return False
        return scene.mosaic.coverage < self._settings.min_coverage or bool(self.open_places(target, resolved))

    def open_places(self, target: SearchTarget, resolved: Sequence[Decision]) -> List[np.ndarray]:
        """Return the places of undecided candidates with too few views."""
        if target.fingerprint.kind == BLANK or target.problem:
            return []
        miss = target.calibration.limits(self._settings.error_rate).miss
        return [
            item.pose[:2]
            for item in resolved
            if item.outcome == UNDECIDED
            and (item.views < MIN_VIEWS or (item.views < self._settings.views and 1.0 - item.residual >= miss))
        ]

    def rank(self, decision: Decision) -> float:
        """Prefer the smallest residual."""
        return decision.residual

    def _judge(self, target: SearchTarget, refined: RefinedPose, scene: ObservedScene, table_match: float) -> Decision:
        """Decide at a pose of the fingerprint's centre, given the share of the scene in the object's colours.

        The pose of the decision is that of the object's visible middle; beliefs refer to the centre.
        """
        limits, value = target.calibration.limits(self._settings.error_rate), refined.similarity
        unseen = self._unseen(scene.mosaic)
        if value <= NOT_SHOWN:
            outcome, reason = UNDECIDED, unseen or "no image shows enough of a candidate place: take more images"
        elif refined.near < MIN_VIEWS and not _is_clearly_below(value, limits.miss):
            outcome, reason = UNDECIDED, unseen or "a candidate place has too few views: take more images"
        elif value >= limits.miss:
            in_plane = target.without_prints and _is_in_table_plane(target, scene.views, refined.pose)
            outcome, reason = _judge_similar(value, limits, in_plane)
        else:
            outcome, reason = _judge_dissimilar(value, limits, unseen, table_match)
        is_compared = refined.near >= MIN_VIEWS and value > NOT_SHOWN
        return replace(
            self._decision(target, refined.pose, outcome, reason),
            pose=target.appearance.middle_at(refined.pose),
            confidence=target.calibration.confidence(value),
            residual=1.0 - value if is_compared else np.inf,
            views=refined.near,
        )

    def _unseen(self, mosaic: Mosaic) -> str:
        """Why too little was seen to state that an object is absent; empty if enough was seen."""
        if mosaic.coverage < self._settings.min_coverage:
            return f"only {100 * mosaic.coverage:.0f} % of the workspace seen: take more images"
        return ""

    def _blank(self, target: SearchTarget, mosaic: Mosaic) -> Decision:
        """Decide whether the learned table is bare somewhere."""
        found, limit = target.bare_table.search(mosaic), target.bare_table.limit(self._settings.error_rate)
        pose = np.array([*found.place, target.fingerprint.centre[2]])
        if found.share >= limit:
            outcome, reason = FOUND, f"{100 * found.share:.0f} % of the place has the table's colours"
        elif not found.known:
            outcome, reason = UNDECIDED, "this table is unknown: learn it to search for bare places"
        elif mosaic.coverage < self._settings.min_coverage:
            outcome, reason = UNDECIDED, self._unseen(mosaic)
        else:
            outcome, reason = NOT_HERE, f"at most {100 * found.share:.0f} % of any place has the table's colours"
        confidence = target.bare_table.confidence(found.share)
        decision = self._decision(target, pose, outcome, reason)
        return replace(decision, confidence=confidence, residual=1.0 - found.share, views=int(mosaic.coverage > 0.0))


class BeliefRule(DecisionRule):
    """Compares the mean belief with a limit (`identification/decision: belief`). Uses no images."""

    def candidates(self, target: SearchTarget, scene: ObservedScene) -> List[Decision]:
        """Decide at each peak of the belief by its mean."""
        return [
            self._judge(target, peak)
            for peak in target.grid.peaks(self._settings.separation, self._settings.candidates)
        ]

    def is_open(self, target: SearchTarget, resolved: Sequence[Decision], scene: ObservedScene) -> bool:
        """Return True: a belief states no error rate at which it could stop."""
        return True

    def open_places(self, target: SearchTarget, resolved: Sequence[Decision]) -> List[np.ndarray]:
        """Return no places: no candidate is undecided."""
        return []

    def rank(self, decision: Decision) -> float:
        """Prefer the highest mean belief."""
        return -decision.belief_mean

    def _judge(self, target: SearchTarget, peak: Peak) -> Decision:
        """Decide at a peak of the belief."""
        found = peak.mean > self._settings.min_belief
        reason = f"belief {peak.mean:.2f} {'above' if found else 'not above'} {self._settings.min_belief:g}"
        decision = self._decision(target, _refined(peak.pose, target.trace), FOUND if found else NOT_HERE, reason)
        return replace(decision, belief_mean=peak.mean, belief_std=peak.std, confidence=peak.mean)


def make_rule(settings: IdentificationConfig) -> DecisionRule:
    """Return the rule that `identification/decision` names."""
    return BeliefRule(settings) if settings.decision == BELIEF else ViewRule(settings)


def _judge_similar(value: float, limits: Limits, in_plane: bool) -> Tuple[str, str]:
    """Outcome and reason at a similarity of at least the miss limit. in_plane: whether nothing stands on the table."""
    if in_plane:
        return NOT_HERE, f"similarity {value:.2f}, but the place lies in the plane of the table"
    if value >= limits.found:
        return FOUND, f"similarity {value:.2f}, limit {limits.found:.2f}"
    return UNDECIDED, (
        f"similarity {value:.2f}, but objects of its colour or shape reach {limits.look_alike:.2f}: look "
        "at the place, or take a fingerprint that shows more of what distinguishes it"
    )


def _judge_dissimilar(value: float, limits: Limits, unseen: str, table_match: float) -> Tuple[str, str]:
    """Outcome and reason at a similarity below the miss limit. unseen: why absence cannot be stated, or empty."""
    if unseen:
        return UNDECIDED, f"best similarity {value:.2f}, but {unseen}"
    # On a table of its colours an object is hardly more similar than the table around it.
    if table_match > _MAX_TABLE_MATCH and not _is_clearly_below(value, limits.miss, 1.0 - table_match):
        return UNDECIDED, (
            f"best similarity {value:.2f}, but {100 * table_match:.0f} % of the scene has the object's colours: "
            "use another table"
        )
    return NOT_HERE, f"best similarity {value:.2f}, limit {limits.miss:.2f}"


def _is_clearly_below(value: float, miss: float, contrast: float = 1.0) -> bool:
    """Whether a similarity above NOT_SHOWN is too low for the object. contrast: factor by which a table lowers it."""
    return NOT_SHOWN < value < min(contrast * _CLEARLY_BELOW * miss, miss)


def _is_in_table_plane(target: SearchTarget, views: SceneViews, pose: np.ndarray) -> bool:
    """Whether nothing stands on the table where the object would be at a pose (3,)."""
    appearance = target.appearance
    relief = views.relief_at(appearance.middle_at(pose)[:2])
    points = to_base_frame(appearance.inside_points[appearance.central_view], pose[np.newaxis])[0]
    return relief is not None and relief.is_in_table_plane(points)


def _poses_at(target: SearchTarget, peak: Peak) -> np.ndarray:
    """Poses (Y, 3) at a peak of a belief, at its yaws of the highest belief."""
    yaws = target.grid.yaw_peaks(peak.pose, _YAWS)
    return np.array([_refined(np.array([*peak.pose[:2], yaw]), target.trace) for yaw in yaws])


def _refined(peak: np.ndarray, trace: Matches) -> np.ndarray:
    """Weighted mean of the measured poses near a peak (3,): finer than the cells of the grid."""
    distance, turn = pose_distance(trace.pose, peak)
    near = (distance < _REFINEMENT_DISTANCE) & (turn < _REFINEMENT_TURN)
    if not near.any():
        return peak
    weights = trace.value[near] / trace.value[near].sum()
    x, y = weights @ trace.pose[near, :2]
    yaw = trace.pose[near, 2]
    return np.array([x, y, np.arctan2(weights @ np.sin(yaw), weights @ np.cos(yaw))])


def _best_decisions(candidates: Sequence[Decision]) -> List[Decision]:
    """Return the found candidates, numbered, or the best other one, an undecided one first. One blank is enough."""
    found = [candidate for candidate in candidates if candidate.found]
    if not found:
        order = sorted(candidates, key=lambda item: (item.outcome != UNDECIDED, item.residual, -item.belief_mean))
        return order[:1]
    if found[0].kind == BLANK:
        found = found[:1]
    return [replace(candidate, instance=number) for number, candidate in enumerate(found, start=1)]
