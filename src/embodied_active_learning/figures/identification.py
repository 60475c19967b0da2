"""The figures of one identification."""

from __future__ import annotations

from pathlib import Path
from typing import List, Sequence

from embodied_active_learning.figures.beliefs import BeliefPanel, draw_beliefs
from embodied_active_learning.figures.mosaic import top_view
from embodied_active_learning.figures.trace import draw_trace
from embodied_active_learning.geometry import Location
from embodied_active_learning.objects.decision import Decision, decisions_about
from embodied_active_learning.objects.search_target import SearchTarget
from embodied_active_learning.pipeline.identification import IdentificationRun

MOST_TRACES = 12
"""Fingerprints of which a trace is drawn; it takes a second each."""


def draw_identification(
    run: IdentificationRun, decisions: Sequence[Decision], objects: Sequence[Location] = ()
) -> List[Path]:
    """Draw figures/beliefs.png of the session whose images were looked at, and a trace for each fingerprint.

    objects: (name, x, y) in metres, where they are known. -> the paths.
    """
    workspace = run.config.workspace.box()
    view = top_view(run.pictures, run.states, run.config.camera, workspace)
    panels = [_panel(item, decisions) for item in run.identification.targets]
    paths = [draw_beliefs(run.figures / "beliefs.png", workspace, panels, view, objects)]
    for item in run.identification.targets[:MOST_TRACES]:
        name = f"{item.session}/{item.fingerprint.name}"
        path = run.folder / f"trace-{item.session}-{item.fingerprint.name}.png"
        own = decisions_about(decisions, item.session, item.fingerprint.name)
        trace = item.trace
        paths.append(
            draw_trace(path, name, trace, run.states, run.pictures, item.fingerprint, item.threshold, own, objects)
        )
    return paths


def _panel(item: SearchTarget, decisions: Sequence[Decision]) -> BeliefPanel:
    mean, std = item.grid.over_yaw()
    return BeliefPanel(
        f"{item.session}\n{item.fingerprint.name}",
        item.fingerprint.thumbnail,
        item.grid.x,
        item.grid.y,
        mean,
        std,
        decisions_about(decisions, item.session, item.fingerprint.name),
    )
