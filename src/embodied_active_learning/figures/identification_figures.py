"""All figures of an identification."""

from __future__ import annotations

from pathlib import Path
from typing import List, Sequence

from embodied_active_learning.figures.belief_maps import BeliefPanel, draw_beliefs
from embodied_active_learning.figures.evidence import Evidence, draw_evidence
from embodied_active_learning.figures.measurement_trace import Trace, draw_trace
from embodied_active_learning.figures.top_view import compose_top_view
from embodied_active_learning.figures.unknown_objects import draw_unknown
from embodied_active_learning.objects.decision import Decision, decisions_about
from embodied_active_learning.objects.fingerprint import OBJECT
from embodied_active_learning.objects.scene_views import SceneViews
from embodied_active_learning.objects.scoring import NO_TRUTH, Truth
from embodied_active_learning.objects.search_target import SearchTarget
from embodied_active_learning.pipeline.identification import IdentificationRun

MAX_TRACES = 12
"""Largest number of traces that are drawn; each takes a second."""


def draw_identification(
    run: IdentificationRun, decisions: Sequence[Decision], truth: Truth = NO_TRUTH, pdf: bool = False
) -> List[Path]:
    """Draw the belief maps into figures/ of the session with the images, and evidence and traces into the results.

    Returns:
        The paths of the figures.
    """
    workspace = run.config.workspace.box()
    view = compose_top_view(run.images, run.states, run.config.camera, workspace)
    panels = [_panel(target, decisions) for target in run.identification.targets]
    by_views = run.identification.by_views
    paths = [draw_beliefs(run.figures / "beliefs.png", workspace, panels, view, truth, pdf, run.unknown, by_views)]
    targets = [target for target in run.identification.targets if target.fingerprint.kind == OBJECT]
    evidence = [_evidence(target, decisions) for target in targets[:MAX_TRACES]]
    if by_views and evidence:
        views = SceneViews(run.states, run.images, run.config.camera)
        paths.append(draw_evidence(run.folder / "evidence.png", evidence, views, pdf))
    if run.unknown:
        paths.append(draw_unknown(run.folder / "unknown.png", run.unknown, pdf))
    for target in run.identification.targets[:MAX_TRACES]:
        own = decisions_about(decisions, target.session, target.fingerprint.name)
        path = run.folder / f"trace-{target.session}-{target.fingerprint.name}.png"
        measured = (target.trace, run.states, run.images)
        trace = Trace(target.label, *measured, target.fingerprint, target.threshold, own, truth)
        paths.append(draw_trace(path, trace, pdf))
    return paths


def _evidence(target: SearchTarget, decisions: Sequence[Decision]) -> Evidence:
    """The best decision about an object."""
    own = decisions_about(decisions, target.session, target.fingerprint.name)
    return Evidence(target.label, target.appearance, own[0])


def _panel(target: SearchTarget, decisions: Sequence[Decision]) -> BeliefPanel:
    """Build the panel of one fingerprint."""
    mean, std = target.grid.over_yaw()
    return BeliefPanel(
        f"{target.session}\n{target.fingerprint.name}",
        target.fingerprint.thumbnail,
        target.grid.x,
        target.grid.y,
        mean,
        std,
        decisions_about(decisions, target.session, target.fingerprint.name),
    )
