"""The explorers by name."""

from __future__ import annotations

from typing import Callable, Dict

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ConfigError
from embodied_active_learning.exploration.baselines import (
    RandomWalkExplorer,
    UniformErgodicExplorer,
    UniformExplorer,
)
from embodied_active_learning.exploration.controller import ErgodicController
from embodied_active_learning.exploration.explorer import Explorer

REGISTRY: Dict[str, Callable[[Config, int], Explorer]] = {
    "ergodic": ErgodicController,
    "random_walk": RandomWalkExplorer,
    "uniform": UniformExplorer,
    "uniform_ergodic": UniformErgodicExplorer,
}


def make_explorer(name: str, config: Config, seed: int) -> Explorer:
    """The explorer of that name, with its own random stream of the seed. Raises ConfigError listing the names."""
    if name not in REGISTRY:
        raise ConfigError(f"unknown explorer {name!r}: there are {', '.join(sorted(REGISTRY))}")
    return REGISTRY[name](config, seed)
