"""Messages of fingerprints, beliefs and decisions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Sequence

import numpy as np
import rospy
from std_msgs.msg import Header

from embodied_active_learning.msg import Belief
from embodied_active_learning.msg import Decision as DecisionMessage
from embodied_active_learning.msg import Fingerprint as FingerprintMessage
from embodied_active_learning.objects.decision import Decision, decisions_about
from embodied_active_learning.objects.fingerprint import Fingerprint, FingerprintSet
from embodied_active_learning.ros import names

if TYPE_CHECKING:
    from embodied_active_learning.objects.search_target import SearchTarget  # slow import of the model


def fingerprint_message(stamp: rospy.Time, found: FingerprintSet, item: Fingerprint) -> FingerprintMessage:
    """Return one fingerprint of a set as a message."""
    x, y, theta = map(float, item.centre)
    return FingerprintMessage(
        header=Header(stamp=stamp, frame_id=names.FRAMES.base),
        session=found.session,
        name=item.name,
        kind=item.kind,
        x=x,
        y=y,
        theta=theta,
        views=len(item.states),
        updates=found.updates,
        importance=item.importance,
    )


def belief_message(target: SearchTarget, decisions: Sequence[Decision]) -> Belief:
    """Return the belief of one fingerprint and the decisions about it."""
    grid = target.grid
    axes = (grid.x, grid.y, grid.yaw)
    own = decisions_about(decisions, target.session, target.fingerprint.name)
    return Belief(
        session=target.session,
        fingerprint=target.fingerprint.name,
        shape=[len(axis) for axis in axes],
        lower=[float(axis[0]) for axis in axes],
        step=[float(axis[1] - axis[0]) for axis in axes],
        mean=grid.mean.astype(np.float32).ravel(),
        std=grid.std.astype(np.float32).ravel(),
        decisions=[decision_message(decision) for decision in own],
    )


def decision_message(decision: Decision) -> DecisionMessage:
    """Return a decision as a message."""
    x, y, theta = map(float, decision.pose)
    return DecisionMessage(
        session=decision.session,
        fingerprint=decision.fingerprint,
        kind=decision.kind,
        outcome=decision.outcome,
        found=decision.found,
        instance=decision.instance,
        x=x,
        y=y,
        theta=theta,
        confidence=decision.confidence,
        error_rate=decision.error_rate,
        residual=decision.residual,
        belief_mean=decision.belief_mean,
        belief_std=decision.belief_std,
        views=decision.views,
        reason=decision.reason,
    )
