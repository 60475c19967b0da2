"""Reading YAML that people write: every complaint names the file, the key, and what would be legal."""

from __future__ import annotations

import difflib
import math
from pathlib import Path
from typing import Any, Iterable, Iterator, Optional, Tuple

from embodied_active_learning.errors import WorldError
from embodied_active_learning.files import FileReader, shown

_LONGEST_KEY = 80  # characters of an unknown key that are looked at and told
_READER = FileReader(WorldError, "give a world as those in worlds/ are", follow=True)


class Section:
    """Keys and values at one place of a file."""

    def __init__(self, values: Any, where: str, known: Iterable[str] = ()) -> None:
        """Keys other than the known ones are refused; without known keys every name is legal."""
        if not isinstance(values, dict) or not all(isinstance(key, str) for key in values):
            raise WorldError(f"{where} is {shown(values)}: give names and values")
        self.where = where
        self._values = values
        self._refuse_unknown(tuple(known))

    @classmethod
    def read(cls, path: Path, known: Iterable[str]) -> Section:
        """The top level of a YAML file."""
        return cls(_READER.read_yaml(path), str(path), known)

    def __contains__(self, key: str) -> bool:
        return key in self._values

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def section(self, key: str, known: Iterable[str] = ()) -> Section:
        """The keys below a key; none when the file leaves it out."""
        return Section(self._values.get(key, {}), self._place(key), known)

    def text(self, key: str, default: Optional[str] = None) -> str:
        """A text that is not empty."""
        value = self._get(key, default)
        if not isinstance(value, str) or not value:
            raise WorldError(f"{self._place(key)} is {shown(value)}: give a text")
        return value

    def number(self, key: str, default: float, low: float = -math.inf, high: float = math.inf) -> float:
        """A finite number in [low, high]."""
        return self._number(self._place(key), self._get(key, default), low, high)

    def numbers(
        self,
        key: str,
        counts: Tuple[int, ...],
        default: Optional[Tuple[float, ...]] = None,
        low: float = -math.inf,
        high: float = math.inf,
    ) -> Tuple[float, ...]:
        """A list of finite numbers in [low, high], as long as one of the counts."""
        value, place = self._get(key, default), self._place(key)
        if not isinstance(value, (list, tuple)) or len(value) not in counts:
            raise WorldError(f"{place} is {shown(value)}: give {' or '.join(map(str, counts))} numbers")
        return tuple(self._number(place, part, low, high) for part in value)

    def _get(self, key: str, default: Any) -> Any:
        value = self._values.get(key, default)
        if value is None:
            raise WorldError(f"{self._place(key)} is missing: write it into the file")
        return value

    def _place(self, key: str) -> str:
        return f"{self.where}: {key}" if self.where.endswith((".yaml", ".yml")) else f"{self.where}/{key}"

    def _refuse_unknown(self, known: Tuple[str, ...]) -> None:
        for key in self._values:
            if known and key not in known:
                nearest = difflib.get_close_matches(key[:_LONGEST_KEY], known, n=1, cutoff=0.4)
                hint = f"did you mean {nearest[0]}?" if nearest else f"known: {', '.join(known)}"
                raise WorldError(f"unknown key {self._place(key[:_LONGEST_KEY])}: {hint}")

    @staticmethod
    def _number(place: str, value: Any, low: float, high: float) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise WorldError(f"{place} is {shown(value)}: give a finite number")
        if not low <= value <= high:
            raise WorldError(f"{place} is {shown(value)}: legal is {low:g} to {high:g}")
        return float(value)
