"""Pictures of a session, drawn without a display."""

from embodied_active_learning.figures.session_figures import draw_all

__all__ = ["draw_all"]
