"""Progress of a run from the trainer's status."""

from __future__ import annotations

from embodied_active_learning.msg import TrainingStatus
from embodied_active_learning.pipeline.progress import Progress


def progress_of(status: TrainingStatus, ergodic_measure: float, paused_by: str) -> Progress:
    """Return the progress of a run.

    Args:
        status: Newest status of the trainer.
        ergodic_measure: Newest ergodic measure [nat].
        paused_by: Names of the nodes that pause the planner; empty if none does.
    """
    return Progress(
        step=status.observations,
        steps=status.steps,
        updates=status.updates,
        updates_planned=status.updates_planned,
        loss=status.loss,
        active_units=status.active_units,
        latent_size=status.latent_size,
        latent_contribution=status.latent_contribution,
        ergodic_measure=ergodic_measure,
        stopping=status.stopping,
        paused_by=paused_by,
    )
