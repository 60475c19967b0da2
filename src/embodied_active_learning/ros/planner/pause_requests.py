"""Who holds a planner back: it goes on when the last of them lets it."""

from __future__ import annotations

import threading
from typing import Set


class PauseRequests:
    """The nodes that have paused a planner, by name.

    One that has paused it takes back its own pause only: a person's pause outlasts that of a fingerprinter, which began
    earlier or later. Anybody else means the whole: a person, whose every call has another name, and for whom there must
    be a way out when a node died that held the planner back.
    """

    def __init__(self, kept: str = "") -> None:
        """Kept: the text that an earlier one has left."""
        self._lock = threading.Lock()
        self._names: Set[str] = set(kept.split())

    @property
    def kept(self) -> str:
        """All names, as a text; empty when there is nobody."""
        with self._lock:
            return " ".join(sorted(self._names))

    def add(self, name: str) -> bool:
        """Note who pauses -> whether nobody did before."""
        with self._lock:
            is_first = not self._names
            self._names.add(name)
            return is_first

    def release(self, name: str) -> bool:
        """Note who lets it go on -> whether that ends the pause; False, too, where there was none."""
        with self._lock:
            was_paused = bool(self._names)
            self._names = self._names - {name} if name in self._names else set()
            return was_paused and not self._names
