"""Registries: the implementations that a configuration chooses by name.

A registry lists its built-in entries as "module:attribute", so that the names are known without importing torch or
scikit-learn. Any other implementation is chosen in the same form, also by nodes, if its module is in PYTHONPATH:

    config = load_config("demo", explorer="my_package.spiral:SpiralExplorer")

Within one process it can be registered under a short name:

    from embodied_active_learning.registry import EXPLORERS

    @EXPLORERS.register("spiral")
    class SpiralExplorer(Explorer): ...

    config = load_config("demo", explorer="spiral")
"""

from __future__ import annotations

import re
from importlib import import_module
from typing import Any, Callable, Dict, Iterator, Mapping, TypeVar, Union

from embodied_active_learning.errors import ConfigError

_Entry = TypeVar("_Entry", bound=Callable[..., Any])
_REFERENCE = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*", re.ASCII)


class Registry:
    """Callables by name; iteration yields the names in order of registration."""

    def __init__(self, kind: str, entries: Mapping[str, str]) -> None:
        """Args: kind: what is registered, for error messages; entries: name -> "module:attribute"."""
        self.kind = kind
        self._entries: Dict[str, Union[str, Callable[..., Any]]] = dict(entries)

    def register(self, name: str) -> Callable[[_Entry], _Entry]:
        """Return a decorator that adds a class or function. Raises ConfigError if the name is taken."""

        def add(entry: _Entry) -> _Entry:
            if name in self._entries:
                raise ConfigError(f"{self.kind} {name!r} is already registered: choose another name")
            self._entries[name] = entry
            return entry

        return add

    def unregister(self, name: str) -> None:
        """Remove an entry."""
        del self._entries[name]

    def __getitem__(self, name: str) -> Callable[..., Any]:
        """Import and return an entry, or what "module:attribute" refers to.

        Raises:
            ConfigError: The name is unknown; the error lists the known ones. Or it cannot be imported.
        """
        if name not in self:
            raise ConfigError(f"unknown {self.kind} {name!r}: known are {', '.join(self)}")
        entry = self._entries.get(name, name)
        if not isinstance(entry, str):
            return entry
        module, _, attribute = entry.partition(":")
        try:
            imported = import_module(module)
        except ImportError as error:
            raise ConfigError(f"{self.kind} {name!r} cannot be imported: {error}; check PYTHONPATH") from error
        try:
            implementation: Callable[..., Any] = getattr(imported, attribute)
        except AttributeError as error:
            raise ConfigError(f"{self.kind} {name!r} cannot be imported: {error}; correct its name") from error
        return implementation

    def __iter__(self) -> Iterator[str]:
        return iter(tuple(self._entries))

    def __len__(self) -> int:
        return len(self._entries)

    def __contains__(self, name: object) -> bool:
        return name in self._entries or (isinstance(name, str) and _REFERENCE.fullmatch(name) is not None)


EXPLORERS = Registry(
    "explorer",
    {
        "ergodic": "embodied_active_learning.exploration.controller:ErgodicController",
        "random_walk": "embodied_active_learning.exploration.baselines:RandomWalkExplorer",
        "uniform": "embodied_active_learning.exploration.baselines:UniformExplorer",
        "uniform_ergodic": "embodied_active_learning.exploration.baselines:UniformErgodicExplorer",
        "active": "embodied_active_learning.exploration.active:ActiveExplorer",
    },
)
"""Values of exploration/explorer: callables (config: Config, seed: int) -> Explorer."""

INFORMATION_MEASURES = Registry(
    "information measure",
    {"conditional_entropy": "embodied_active_learning.exploration.ergodic_objective:target_distribution"},
)
"""Values of exploration/measure: callables (log_std (S,), coverage k) -> target distribution (S,), sum 1."""
