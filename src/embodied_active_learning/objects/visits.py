"""Visits: where the camera looks after an identification, and what it should see there."""

from __future__ import annotations

from typing import List, NamedTuple, Optional, Sequence

import numpy as np

from embodied_active_learning.geometry import pose_distance, transform_poses
from embodied_active_learning.objects.decision import UNDECIDED, Decision
from embodied_active_learning.objects.fingerprint import OBJECT
from embodied_active_learning.objects.identification import Identification
from embodied_active_learning.objects.search_target import SearchTarget
from embodied_active_learning.objects.unknown import UnknownObject
from embodied_active_learning.workspace import Workspace

_TURN_COST = 0.05
"""Distance [m] that counts as much as a yaw of 1 rad when a stored view is chosen."""


class Destination(NamedTuple):
    """A place to visit, and the view that is expected there.

    Attributes:
        label: `<session>/<fingerprint>/<instance>`, with "undecided" in place of the instance if the object was not
            found; or `unknown-<number>`.
        place: (2,) x [m], y [m] of the object in the base frame.
        state: (3,) camera state to view it from [m, m, rad], in the workspace.
        known: (H, W, 3) uint8 what is known of it: a view of the fingerprint, or an unknown object from above as the
            search has seen it.
        expected: What the model knows of it; None of an unknown object.
    """

    label: str
    place: np.ndarray
    state: np.ndarray
    known: np.ndarray
    expected: Optional[Expectation]


class Expectation(NamedTuple):
    """An object of a fingerprint, as its model predicts it.

    Attributes:
        target: The fingerprint.
        view: Index of the fingerprint's view whose latent is decoded.
        pose: (3,) pose of the fingerprint's centre in the searched workspace [m, m, rad].
    """

    target: SearchTarget
    view: int
    pose: np.ndarray

    def image_from(self, state: np.ndarray) -> np.ndarray:
        """Return the predicted image (H, W, 3) uint8 from a camera state (3,) of the searched workspace."""
        fingerprint = self.target.fingerprint
        learned = transform_poses(state, self.pose, fingerprint.centre)
        means, _ = self.target.model.decode(fingerprint.latent_means[[self.view]], learned[np.newaxis])
        return np.rint(255.0 * means[0]).astype(np.uint8)


class Visit(NamedTuple):
    """A picture taken at a destination.

    Attributes:
        destination: Where.
        state: (3,) camera state at the picture [m, m, rad].
        picture: (H, W, 3) uint8.
        prediction: (H, W, 3) uint8 what the model predicts from that state; None of an unknown object.
    """

    destination: Destination
    state: np.ndarray
    picture: np.ndarray
    prediction: Optional[np.ndarray]


def make_visit(destination: Destination, state: np.ndarray, picture: np.ndarray) -> Visit:
    """Return the visit of a destination: a picture (H, W, 3) uint8 from a state (3,), with the model's prediction."""
    expected = destination.expected
    return Visit(destination, state, picture, None if expected is None else expected.image_from(state))


def plan_visits(
    identification: Identification,
    decisions: Sequence[Decision],
    unknown: Sequence[UnknownObject],
    workspace: Workspace,
) -> List[Destination]:
    """Return a destination for every found object and undecided candidate, then for every unknown object.

    Blanks, and candidates without a comparison of views, are not visited. An object is viewed as in a view of its
    fingerprint, from nearly above. Instead of a state outside the workspace, the nearest one inside is used.
    """
    targets = {(target.session, target.fingerprint.name): target for target in identification.targets}
    judged = [
        decision
        for decision in decisions
        if decision.kind == OBJECT
        and (decision.found or (decision.outcome == UNDECIDED and np.isfinite(decision.residual)))
    ]
    destinations = [
        _to_object(targets[decision.session, decision.fingerprint], decision, identification.by_views, workspace)
        for decision in judged
    ]
    for number, item in enumerate(unknown, start=1):
        state = workspace.clip([*item.place, workspace.centre[2]])
        destinations.append(Destination(f"unknown-{number}", item.place, state, item.picture[::-1], None))
    return destinations


def _to_object(target: SearchTarget, decision: Decision, by_views: bool, workspace: Workspace) -> Destination:
    """Return the destination for an object of a fingerprint, where it was found or may be."""
    fingerprint = target.fingerprint
    pose = target.appearance.centre_at(decision.pose) if by_views else decision.pose
    wanted = transform_poses(fingerprint.states, fingerprint.centre, pose)
    possible = workspace.nearest(wanted)
    distance, turn = pose_distance(possible, wanted)
    off_centre, _ = pose_distance(fingerprint.states, fingerprint.centre)
    view = int(np.argmin(distance + _TURN_COST * turn + off_centre))
    return Destination(
        label=f"{target.label}/{decision.instance if decision.found else decision.outcome}",
        place=decision.pose[:2],
        state=possible[view],
        known=fingerprint.images[view],
        expected=Expectation(target, view, pose),
    )
