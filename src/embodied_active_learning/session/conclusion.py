"""The end of a launch: its result is computed from the session's tables and written to summary.yaml."""

from __future__ import annotations

import math
from typing import Dict, Optional

import numpy as np

from embodied_active_learning.model.verdict import NO_TRAINING, judge_run
from embodied_active_learning.objects.stability import reason_to_end
from embodied_active_learning.session.observations import count_observations
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.summary import Summary, readable_summary, write_summary


def summarise(session: Session, finished: bool, wall_time: float) -> Summary:
    """Return the summary of a session's tables.

    Args:
        session: The session.
        finished: Whether the run is complete.
        wall_time: Seconds of all launches.
    """
    exploration, training, evaluation = (session.read_table(name) for name in ("exploration", "training", "evaluation"))
    updates = int(_last(training, "update") or 0)
    errors = {name: _last(evaluation, name) for name in ("mse_own", "mse_shuffled", "mse_none")}
    ergodic_measure = _last(exploration, "ergodic_measure")
    ended = _reason_to_end(session)
    verdict = judge_run(updates, ergodic_measure=ergodic_measure, **errors, ended=ended)
    if session.config.training.updates_per_observation == 0:
        verdict = NO_TRAINING
    return Summary(
        finished=finished,
        # A step that was interrupted after its observation has no row.
        steps=max(int(_last(exploration, "step") or 0), count_observations(session.paths.observations)),
        updates=updates,
        wall_time=round(float(wall_time), 3),
        active_units=_last(evaluation, "active_units"),
        ergodic_measure=ergodic_measure,
        coverage=_last(exploration, "coverage"),
        distance=_last(exploration, "distance"),
        **errors,
        ended=ended,
        verdict=str(verdict),
    )


def conclude_launch(session: Session, finished: bool, wall_time: float) -> Summary:
    """Write and return the summary at the end of a launch.

    Args:
        session: The session.
        finished: Whether the run is complete.
        wall_time: Seconds of this launch; those of earlier launches are added.
    """
    previous = readable_summary(session.paths.summary)
    summary = summarise(session, finished, wall_time + (previous.wall_time if previous else 0.0))
    write_summary(session.paths.summary, summary)
    return summary


def _reason_to_end(session: Session) -> str:
    """Return why the stopping criterion has ended the run; empty if it has not."""
    if not session.config.may_stop_early:
        return ""
    table = session.read_table("stopping")
    return reason_to_end(int(table["objects"][-1])) if table["stopped"][-1:].any() else ""


def _last(table: Dict[str, np.ndarray], column: str) -> Optional[float]:
    values = table[column]
    return float(values[-1]) if len(values) and math.isfinite(values[-1]) else None
