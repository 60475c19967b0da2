"""The rule that turns beliefs and views into decisions.

The paper does not state when a fingerprint counts as identified. This rule (`identification/decision: verified`) asks
the views of each belief peak whether they agree with the fingerprint; the alternative (`belief`) is a limit on the
mean belief.
"""

from __future__ import annotations

from dataclasses import replace
from typing import List, Sequence, Tuple

import numpy as np

from embodied_active_learning.config import IdentificationConfig
from embodied_active_learning.geometry import pose_distance
from embodied_active_learning.objects.beliefs import Peak
from embodied_active_learning.objects.decision import Decision
from embodied_active_learning.objects.fingerprint import BLANK
from embodied_active_learning.objects.matching import Matches
from embodied_active_learning.objects.search_target import SearchTarget
from embodied_active_learning.objects.verification import Comparison

_YAWS = 3
"""Yaws compared at each peak, highest belief first."""
_REFINEMENT_DISTANCE = 0.02  # m
_REFINEMENT_TURN = 0.5  # rad


class DecisionRule:
    """Decides for the fingerprints of one model."""

    def __init__(self, settings: IdentificationConfig) -> None:
        """Use the limits of the settings."""
        self._settings = settings

    def decide(self, targets: Sequence[SearchTarget], states: np.ndarray, images: np.ndarray) -> List[Decision]:
        """Decide for every target.

        An object is found at each candidate (peak of its belief) whose views agree with its fingerprint. Of several
        objects at the same place, the one with the highest confidence is found there.

        Args:
            targets: Fingerprints of one model.
            states: (N, 3) camera states [m, m, rad] of the images observed so far.
            images: (N, H, W, 3) uint8.
        """
        candidates = [self._candidates(target, states, images) for target in targets]
        winners = self._winners([candidate for group in candidates for candidate in group])
        decisions: List[Decision] = []
        for group in candidates:
            decisions += _numbered([_resolved(candidate, winners) for candidate in group])
        return decisions

    def _winners(self, candidates: Sequence[Decision]) -> List[Tuple[Decision, Decision]]:
        """Pair each accepted candidate with the winner of its place: itself, or a better one of the same kind."""
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

    def _candidates(self, target: SearchTarget, states: np.ndarray, images: np.ndarray) -> List[Decision]:
        """Decide for each peak of a belief, highest first, without regard to other targets."""
        peaks = target.grid.peaks(self._settings.separation, self._settings.candidates)
        return [self._best_yaw(target, peak, states, images) for peak in peaks]

    def _best_yaw(self, target: SearchTarget, peak: Peak, states: np.ndarray, images: np.ndarray) -> Decision:
        """Decide at a peak, at the yaw with the highest belief whose views agree.

        An object may look similar from two sides. At the wrong yaw, views are explained badly, or the camera could not
        have been over the learned object.
        """
        if target.fingerprint.kind == BLANK:
            # A blank looks the same at all yaws; with its own yaw, every view can be compared.
            pose = np.array([*peak.pose[:2], target.fingerprint.centre[2]])
            return self._decide_at(target, peak, pose, states, images)
        tried: List[Decision] = []
        for yaw in target.grid.yaw_peaks(peak.pose, _YAWS):
            pose = _refined(np.array([*peak.pose[:2], yaw]), target.trace)
            tried.append(self._decide_at(target, peak, pose, states, images))
            if tried[-1].found:
                break
        return max(tried, key=lambda decision: (decision.found, decision.confidence))

    def _decide_at(
        self, target: SearchTarget, peak: Peak, pose: np.ndarray, states: np.ndarray, images: np.ndarray
    ) -> Decision:
        """Decide at a pose (3,) near a peak."""
        settings = self._settings
        views = target.verifier.views(pose, states)
        pointing = self._pointing(target, views, pose)
        prominent = target.fingerprint.kind == BLANK or peak.prominence >= settings.min_prominence
        enough = len(views) >= settings.min_views and pointing.mean() >= settings.min_agreement
        if settings.decision == "verified" and prominent and enough:
            comparison = target.verifier.compare(pose, states, images)
        else:
            comparison = Comparison(views, np.full(len(views), np.inf))  # rejected anyway: skip the decoder
        agreeing = pointing & (np.abs(comparison.residual) <= settings.residual_limit)
        found, reason = self._judge(peak, prominent, pointing, agreeing)
        return Decision(
            session=target.session,
            fingerprint=target.fingerprint.name,
            kind=target.fingerprint.kind,
            found=found,
            instance=0,
            pose=pose,
            confidence=float(agreeing.mean()) if len(agreeing) >= settings.min_views else 0.0,
            residual=comparison.median,
            views=len(agreeing),
            belief_mean=peak.mean,
            belief_std=peak.std,
            reason=reason,
        )

    def _pointing(self, target: SearchTarget, views: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Which of the views (V,) measured the object at the pose; for a blank, which has no place, all of them."""
        if target.fingerprint.kind == BLANK or not len(views):
            return np.ones(len(views), dtype=bool)
        distance, _ = pose_distance(target.trace.pose[views], pose)
        return distance <= self._settings.agreement_distance

    def _judge(self, peak: Peak, prominent: bool, pointing: np.ndarray, agreeing: np.ndarray) -> Tuple[bool, str]:
        """Return whether the object is found, given its views (V,), and the reason."""
        settings, views = self._settings, len(agreeing)
        if settings.decision == "belief":
            found = peak.mean > settings.min_belief
            return found, f"belief {peak.mean:.2f} {'above' if found else 'not above'} {settings.min_belief:g}"
        if views < settings.min_views:
            return False, f"only {views} views, {settings.min_views} required"
        if not prominent:
            return False, f"belief only {peak.prominence:.3f} above its median, {settings.min_prominence:g} required"
        if pointing.mean() < settings.min_agreement:
            return False, f"{pointing.sum()} of {views} views point here"
        return bool(agreeing.mean() >= settings.min_agreement), f"{agreeing.sum()} of {views} views agree"


def _resolved(candidate: Decision, winners: Sequence[Tuple[Decision, Decision]]) -> Decision:
    """Return the candidate, rejected if another fingerprint of the same model won its place."""
    for other, winner in winners:
        if other is candidate and winner is not candidate:
            return replace(candidate, found=False, reason=f"{winner.fingerprint} fits better there")
    return candidate


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


def _numbered(candidates: Sequence[Decision]) -> List[Decision]:
    """Number the accepted candidates, or return the best rejected one. One place of a blank is enough."""
    found = [candidate for candidate in candidates if candidate.found]
    if not found:
        return sorted(candidates, key=lambda candidate: (-candidate.confidence, -candidate.belief_mean))[:1]
    if found[0].kind == BLANK:
        found = found[:1]
    return [replace(candidate, instance=number) for number, candidate in enumerate(found, start=1)]
