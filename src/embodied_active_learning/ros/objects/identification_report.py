"""Reports the outcome of an identification: its figures, a log message and the fields of the service's response."""

from __future__ import annotations

from typing import Any, Dict, Sequence

import rospy

from embodied_active_learning.figures.identification_figures import draw_identification
from embodied_active_learning.objects.decision import Decision
from embodied_active_learning.objects.decision_table import decision_table, unknown_text
from embodied_active_learning.pipeline.identification import IdentificationRun
from embodied_active_learning.ros.objects.messages import decision_message
from embodied_active_learning.ros.runtime.node import try_to_draw
from embodied_active_learning.simulation.truth import true_scene


def report_identification(run: IdentificationRun, decisions: Sequence[Decision], pdf: bool) -> None:
    """Draw the figures and log the decisions. pdf: whether figures are stored as PDF too."""
    truth = true_scene(run.config, run.sets)
    rospy.loginfo("drawing figures")
    figures = try_to_draw(draw_identification, run, decisions, truth, pdf) or ["none"]
    paths = "\n           ".join(map(str, figures))
    rospy.loginfo(
        "identified:\n\n%s\n\n  %s\n  results  %s\n  figures  %s",
        decision_table(decisions, truth),
        unknown_text(run.unknown),
        run.folder,
        paths,
    )


def response_fields(run: IdentificationRun, decisions: Sequence[Decision]) -> Dict[str, Any]:
    """Return the fields of the response, without success; the action's result has the same."""
    found = sum(decision.found for decision in decisions)
    return {
        "message": f"found in {found} places after {run.processed} images; {unknown_text(run.unknown)}",
        "folder": str(run.folder),
        "decisions": [decision_message(decision) for decision in decisions],
    }
