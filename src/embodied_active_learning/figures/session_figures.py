"""All figures of one session."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import List, Optional, Sequence

from embodied_active_learning.figures.entropy_map import draw_entropy
from embodied_active_learning.figures.learning_metrics import draw_learning_metrics
from embodied_active_learning.figures.mosaic import Seen, look_back
from embodied_active_learning.figures.reconstructions import draw_reconstructions
from embodied_active_learning.geometry import Location
from embodied_active_learning.session.newest_model import load_newest_model
from embodied_active_learning.session.session import Session

_LOG = logging.getLogger(__name__)


def draw_all(session: Session, objects: Sequence[Location] = (), seen: Optional[Seen] = None) -> List[Path]:
    """Draw into the session's figures/ and return the paths. objects: (name, x, y) in metres, where they are known.

    Those that need a trained model are left out as long as there is none. seen: what look_back has answered, where
    that was asked already.
    """
    folder = session.paths.figures
    seen = look_back(session) if seen is None else seen
    paths = [draw_learning_metrics(folder / "learning_metrics.png", [session], lambda _: seen)]
    trained = load_newest_model(session)
    if trained is None:
        _LOG.info("%s has learned nothing yet: only %s was drawn", session.paths.path, paths[0].name)
        return paths
    paths.append(draw_entropy(folder / "entropy.png", session, trained.model, seen, objects))
    paths.append(draw_reconstructions(folder / "reconstructions.png", trained.model, seen.observations))
    return paths
