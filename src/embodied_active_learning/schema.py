"""Checked dataclasses: build them from plain data (YAML, JSON) with types, ranges and legal values enforced.

Declare a frozen dataclass; type, default and `setting` say what is legal:

    @dataclass(frozen=True)
    class ObjectSettings:
        urdf: str = required("URDF file of the object")
        position: Tuple[float, ...] = required("centre of the mesh", "m", length=2)
        yaw: float = setting(0.0, "rotation about the vertical", "rad", -math.pi, math.pi)
        colour: Optional[Tuple[float, ...]] = setting(None, "RGB or RGBA", low=0.0, high=1.0, length=(3, 4))

    @dataclass(frozen=True)
    class WorldSettings:
        table: TableSettings = field(default_factory=TableSettings)
        objects: Dict[str, ObjectSettings] = field(default_factory=dict)

    world = load(WorldSettings, path, FileReader(WorldError, "see the worlds in worlds/", follow=True))

Supported types: bool, int, float, str, Tuple[T, ...], Dict[str, T], Optional[T], other checked dataclasses, and Any,
which is not checked. Every error names the file, the key and the legal values:

    table.yaml: unknown key objects/duck/positon: did you mean objects/duck/position?; see the worlds in worlds/
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import re
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Collection, Dict, Iterator, Mapping, Tuple, Type, TypeVar, Union, get_type_hints

from embodied_active_learning.errors import ConfigError, EmbodiedActiveLearningError
from embodied_active_learning.files import FileReader, short_repr
from embodied_active_learning.registry import Registry

_MAX_KEY_LENGTH = 80  # characters of an unknown key in a message
_EXPONENT = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]{1,3}")  # PyYAML reads 1e-4 as text
_NO_METADATA: Dict[str, Any] = {"low": -math.inf, "high": math.inf, "choices": (), "length": ()}
_Class = TypeVar("_Class")


def setting(
    default: Any,
    meaning: str,
    unit: str = "",
    low: float = -math.inf,
    high: float = math.inf,
    choices: Collection[str] = (),
    length: Union[int, Tuple[int, ...]] = (),
    fixed: bool = False,
) -> Any:
    """Return a dataclass field with documentation and legal values.

    Args:
        default: Value if the key is absent.
        meaning: One phrase for the parameter table.
        unit: Unit for the parameter table and messages.
        low: Smallest legal number.
        high: Largest legal number.
        choices: Legal texts; looked up on each check, so a Registry may grow.
        length: Legal number or numbers of elements of a tuple; any from one up if omitted.
        fixed: Whether stored observations and weights depend on it, so that a session is continued with the same value.
    """
    lengths = (length,) if isinstance(length, int) else tuple(length)
    documentation = {"meaning": meaning, "unit": unit, "fixed": fixed}
    legal = {"low": low, "high": high, "choices": choices, "length": lengths}
    return field(default=default, metadata={**documentation, **legal})


def required(meaning: str, unit: str = "", **legal: Any) -> Any:
    """Return a field like `setting` whose key must be present. Texts must not be empty."""
    return setting(dataclasses.MISSING, meaning, unit, **legal)


def build(
    cls: Type[_Class],
    values: Any,
    subject: Any = "",
    error: Type[EmbodiedActiveLearningError] = ConfigError,
    remedy: str = "",
    stored: bool = False,
) -> _Class:
    """Build a checked dataclass from plain data.

    Args:
        cls: The dataclass.
        values: Mapping from field names to plain values.
        subject: Origin of the values for messages, usually a path.
        error: Exception class to raise.
        remedy: End of every message.
        stored: The values are of an earlier run, so that names in a registry need not be registered now.

    Raises:
        error: Unknown or missing key, wrong type, value out of range, or a ValueError of the dataclass itself.
    """
    return _Builder(subject, error, remedy, stored).build(cls, values, "")


def load(cls: Type[_Class], path: Path, reader: FileReader) -> _Class:
    """Read a YAML file into a checked dataclass. Raises the reader's error."""
    return build(cls, reader.read_yaml(path), path, reader.error, reader.remedy)


def check_keys(cls: type, values: Any, subject: Any = "") -> Dict[str, Any]:
    """Check part of the keys of a dataclass, and return their values converted. Raises ConfigError.

    Missing keys and relations between keys are not checked: the values may be completed from elsewhere.
    """
    return _Builder(subject, ConfigError, "").check(cls, values, "", complete=False)


def to_plain(value: Any) -> Any:
    """Return a dataclass as nested dictionaries and lists, ready for YAML or JSON."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {item.name: to_plain(getattr(value, item.name)) for item in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {key: to_plain(part) for key, part in value.items()}
    return [to_plain(part) for part in value] if isinstance(value, (list, tuple)) else value


def settings(cls: type) -> Iterator[Tuple[str, dataclasses.Field]]:
    """Yield every (section, field) of a dataclass of sections in the order of declaration."""
    for outer in dataclasses.fields(cls):
        for item in dataclasses.fields(_hints(cls)[outer.name]):
            yield outer.name, item


def legal_values(item: dataclasses.Field) -> str:
    """Return the legal values of a field for documentation; empty if all values of its type are legal."""
    if item.metadata["choices"]:
        return " | ".join(item.metadata["choices"])
    low, high = item.metadata["low"], item.metadata["high"]
    return "" if math.isinf(low) and math.isinf(high) else f"{low:g} .. {high:g}"


def suggestion(name: str, known: Collection[str], prefix: str = "") -> str:
    """Return "did you mean X?" for the most similar name, or the list of known names."""
    similar = difflib.get_close_matches(name[:_MAX_KEY_LENGTH], list(known), n=1, cutoff=0.4)
    return f"did you mean {prefix}{similar[0]}?" if similar else f"known are {', '.join(known)}"


@dataclass(frozen=True)
class _Builder:
    """Checks plain data; place is the path of keys to a value, joined by slashes."""

    subject: Any
    error: Type[EmbodiedActiveLearningError]
    remedy: str
    stored: bool = False

    def build(self, cls: Type[_Class], values: Any, place: str) -> _Class:
        checked = self.check(cls, values, place, complete=True)
        try:
            return cls(**checked)
        except (ValueError, TypeError) as error:
            raise self._refuse(f"{place}: {error}" if place else str(error)) from error

    def check(self, cls: type, values: Any, place: str, complete: bool) -> Dict[str, Any]:
        """Return the checked values of a dataclass; nested ones are built only if the values are complete."""
        known = {item.name: item for item in dataclasses.fields(cls)}
        sections = all(map(_is_section, _hints(cls).values()))
        inside = {item.name: f"{section}/{item.name}" for section, item in settings(cls)} if sections else {}
        self._check_names(values, known, place, inside)
        if complete:
            for name, item in known.items():
                if name not in values and item.default is item.default_factory is dataclasses.MISSING:
                    raise self._refuse(f"{_join(place, name)} is missing")
        checked = {}
        for name, value in values.items():
            kind, at = _hints(cls)[name], _join(place, name)
            if not complete and _is_section(kind):
                checked[name] = self.check(kind, value, at, complete)
            else:
                checked[name] = self._value(kind, known[name], value, at)
        return checked

    def _check_names(self, values: Any, known: Collection[str], place: str, inside: Mapping[str, str]) -> None:
        """Check the keys of a mapping. inside: of a mapping of sections, the paths of the keys in them by name."""
        if not isinstance(values, dict):
            name = f"section {place}" if place else "the content"
            raise self._refuse(f"{name} is {short_repr(values)}: expected keys and values")
        for key in values:
            if key not in known:
                text, prefix = str(key)[:_MAX_KEY_LENGTH], f"{place}/" if place else ""
                kind = "section" if inside else "key"
                hint = f"did you mean {inside[text]}?" if text in inside else suggestion(text, known, prefix)
                raise self._refuse(f"unknown {kind} {prefix}{text}: {hint}")

    def _value(self, kind: Any, item: dataclasses.Field, value: Any, place: str) -> Any:
        """Check a value against a type. item: the dataclass field with default and legal values."""
        inner, origin = _arguments(kind), getattr(kind, "__origin__", None)
        if kind is Any or (value is None and type(None) in inner):
            return value
        if _is_section(kind):
            return self.build(kind, value, place)
        if origin is Union:
            return self._value(inner[0], item, value, place)
        if origin is dict:
            self._check_names(value, value, place, {})
            return {key: self._value(inner[1], item, part, _join(place, key)) for key, part in value.items()}
        return self._tuple(inner[0], item, value, place) if origin is tuple else self._scalar(kind, item, value, place)

    def _scalar(self, kind: type, item: dataclasses.Field, value: Any, place: str) -> Any:
        if kind is bool:
            if not isinstance(value, bool):
                raise self._wrong(place, value, "true or false")
            return value
        legal = {**_NO_METADATA, **item.metadata}
        return self._text(item, legal, value, place) if kind is str else self._number(kind, legal, value, place)

    def _tuple(self, kind: Any, item: dataclasses.Field, value: Any, place: str) -> Tuple[Any, ...]:
        lengths, numeric = item.metadata.get("length", ()), kind in (int, float)
        elements = "numbers" if numeric else "elements"
        expected = " or ".join(map(str, lengths)) or "at least 1"
        if not isinstance(value, (list, tuple)):
            raise self._wrong(place, value, f"a list of {expected} {elements}" if lengths else f"a list of {elements}")
        if len(value) not in lengths if lengths else numeric and not value:
            raise self._refuse(f"{place} has {len(value)} {elements}: expected {expected}")
        places = (place if numeric else _join(place, index) for index in range(len(value)))
        return tuple(self._value(kind, item, part, at) for part, at in zip(value, places))

    def _text(self, item: dataclasses.Field, legal: Mapping[str, Any], value: Any, place: str) -> str:
        if not isinstance(value, str) or (not value and item.default is dataclasses.MISSING):
            raise self._wrong(place, value, "a text")
        choices = legal["choices"]
        if choices and value not in choices and not (self.stored and isinstance(choices, Registry)):
            hint = suggestion(value, choices)
            ending = f"; {hint}" if hint.startswith("did") else ""
            raise self._wrong(place, value, f"one of {', '.join(choices)}{ending}")
        return value

    def _number(self, kind: type, legal: Mapping[str, Any], value: Any, place: str) -> Any:
        number = float(value) if isinstance(value, str) and _EXPONENT.fullmatch(value) else value
        expected = f"a {'whole ' if kind is int else ''}number"
        if isinstance(number, bool) or not isinstance(number, (int, float)) or not _is_finite(number):
            raise self._wrong(place, value, expected)
        if kind is int and number != int(number):
            raise self._wrong(place, value, expected)
        if not legal["low"] <= number <= legal["high"]:
            raise self._wrong(place, value, f"{expected} {_range(legal)}")
        return kind(number)

    def _wrong(self, place: str, value: Any, expected: str) -> EmbodiedActiveLearningError:
        return self._refuse(f"{place} is {short_repr(value)}: expected {expected}")

    def _refuse(self, complaint: str) -> EmbodiedActiveLearningError:
        subject = f"{self.subject}: " if self.subject else ""
        return self.error(f"{subject}{complaint}{f'; {self.remedy}' if self.remedy else ''}")


def _range(legal: Mapping[str, Any]) -> str:
    """Return "from 0 to 2 m" for the bounds of a number."""
    low = "" if math.isinf(legal["low"]) else f"from {legal['low']:g} "
    high = "" if math.isinf(legal["high"]) else f"to {legal['high']:g} "
    return f"{low or 'up '}{high}{legal.get('unit') or ''}".strip()


def _is_finite(number: Union[int, float]) -> bool:
    try:
        return math.isfinite(number)
    except OverflowError:  # an integer that no float can hold
        return False


def _join(place: str, key: Any) -> str:
    return f"{place}/{str(key)[:_MAX_KEY_LENGTH]}" if place else str(key)[:_MAX_KEY_LENGTH]


def _arguments(kind: Any) -> Tuple[Any, ...]:
    return getattr(kind, "__args__", None) or ()


def _is_section(kind: Any) -> bool:
    return dataclasses.is_dataclass(kind)


@lru_cache(maxsize=None)
def _hints(cls: type) -> Dict[str, Any]:
    """Return the resolved types of the fields."""
    hints: Dict[str, Any] = get_type_hints(cls)
    return {item.name: hints[item.name] for item in dataclasses.fields(cls)}
