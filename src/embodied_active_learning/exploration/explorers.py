"""Construction of explorers by name."""

from __future__ import annotations

from embodied_active_learning.config import Config
from embodied_active_learning.exploration.explorer import Explorer
from embodied_active_learning.registry import EXPLORERS


def make_explorer(name: str, config: Config, seed: int) -> Explorer:
    """Return a new explorer with its own random stream. Raises ConfigError listing the registered names."""
    return EXPLORERS[name](config, seed)
