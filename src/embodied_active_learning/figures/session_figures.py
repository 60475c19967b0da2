"""All figures of a learning session."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import List, Sequence

from embodied_active_learning.figures.entropy_map import draw_entropy
from embodied_active_learning.figures.learning_metrics import draw_learning_metrics
from embodied_active_learning.figures.reconstructions import draw_reconstructions
from embodied_active_learning.figures.stopping import draw_stopping
from embodied_active_learning.figures.top_view import load_session_images
from embodied_active_learning.objects.scoring import TrueObject
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.session_model import load_session_model

_LOG = logging.getLogger(__name__)


def draw_session_figures(session: Session, objects: Sequence[TrueObject] = ()) -> List[Path]:
    """Draw the learning metrics, the entropy map and reconstructions into the session's figures/.

    Entropy map and reconstructions need a trained model and are skipped without one.

    Args:
        session: The session.
        objects: The true objects, where they are known.

    Returns:
        The paths of the figures.
    """
    folder, pdf = session.paths.figures, session.config.session.pdf_figures
    loaded = load_session_images(session)
    camera_path = loaded.observations.raw_states, loaded.table
    paths = [draw_learning_metrics(folder / "learning_metrics.png", [session], lambda _: camera_path, pdf)]
    if session.config.may_stop_early and len(session.read_table("stopping")["update"]):
        paths.append(draw_stopping(folder / "stopping.png", session, pdf))
    trained = load_session_model(session)
    if trained is None:
        _LOG.info("%s has no trained model yet: no entropy map was drawn", session.paths.path)
        return paths
    paths.append(draw_entropy(folder / "entropy.png", session, trained.model, loaded, objects, pdf))
    paths.append(draw_reconstructions(folder / "reconstructions.png", trained.model, loaded.observations, pdf))
    return paths
