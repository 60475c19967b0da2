"""Pictures of a session, drawn without a display."""

from embodied_active_learning.figures.mosaic import look_back
from embodied_active_learning.figures.session_figures import draw_all

__all__ = ["draw_all", "look_back"]
