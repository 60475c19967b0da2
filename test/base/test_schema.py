"""Checked dataclasses: conversion of plain data, and errors that name file, key and legal values."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Dict, Optional, Tuple

import pytest

from embodied_active_learning.config import Config, load_profile
from embodied_active_learning.errors import ConfigError, CorruptFileError, WorldError
from embodied_active_learning.files import FileReader, parse_yaml
from embodied_active_learning.registry import Registry
from embodied_active_learning.schema import build, legal_values, load, required, setting, settings, suggestion, to_plain

READER = FileReader(CorruptFileError, "restore it")
KINDS = Registry("kind", {"round": "math:sin"})


@dataclass(frozen=True)
class Item:
    """One element of a dictionary."""

    urdf: str = required("model")
    position: Tuple[float, ...] = required("place", "m", length=2)
    yaw: float = setting(0.0, "rotation", "rad", -math.pi, math.pi)
    colour: Optional[Tuple[float, ...]] = setting(None, "colour", low=0.0, high=1.0, length=(3, 4))


@dataclass(frozen=True)
class Scene:
    """A dataclass with every supported type."""

    items: Dict[str, Item] = field(default_factory=dict)
    sequence: Tuple[Item, ...] = ()
    names: Tuple[str, ...] = ()
    counters: Dict[str, int] = field(default_factory=dict)
    kind: str = setting("round", "shape", choices=KINDS)
    updates: int = setting(0, "counter", "", 0)
    finished: bool = False
    loss: Optional[float] = None
    anything: Any = None

    def __post_init__(self) -> None:
        if self.updates == 13:
            raise ValueError("updates is 13: choose another number")


DUCK = {"urdf": "duck.urdf", "position": [1, 2.5]}


def test_every_supported_type_is_built():
    scene = build(
        Scene,
        {
            "items": {"duck": {**DUCK, "colour": [0, 1, 0.5]}},
            "sequence": [DUCK],
            "names": ["a"],
            "counters": {"steps": 3},
            "updates": 2.0,
            "finished": True,
            "loss": 1,
            "anything": {"free": [1]},
        },
    )
    assert scene.items["duck"] == Item("duck.urdf", (1.0, 2.5), 0.0, (0.0, 1.0, 0.5))
    assert scene.sequence == (Item("duck.urdf", (1.0, 2.5)),)
    assert (scene.names, scene.counters, scene.updates, scene.finished) == (("a",), {"steps": 3}, 2, True)
    assert isinstance(scene.updates, int)
    assert isinstance(scene.loss, float)
    assert scene.anything == {"free": [1]}


def test_plain_data_of_a_dataclass_builds_it_again():
    scene = Scene(items={"duck": Item("a", (1.0, 2.0))}, names=("a", "b"), loss=0.5)
    assert to_plain(scene)["names"] == ["a", "b"]
    assert build(Scene, to_plain(scene)) == scene


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"itmes": {}}, "unknown key itmes: did you mean items?"),
        ({"items": {"a": {**DUCK, "positon": 1}}}, "unknown key items/a/positon: did you mean items/a/position?"),
        ({"items": {"a": {"urdf": "x"}}}, "items/a/position is missing"),
        ({"items": {"a": {**DUCK, "urdf": ""}}}, "items/a/urdf is '': expected a text"),
        ({"items": {"a": {**DUCK, "position": [1]}}}, "items/a/position has 1 numbers: expected 2"),
        ({"items": {"a": {**DUCK, "position": [1, "x"]}}}, "items/a/position is 'x': expected a number"),
        ({"items": {"a": {**DUCK, "yaw": 90}}}, "items/a/yaw is 90: expected a number from -3.14159 to 3.14159 rad"),
        ({"items": {"a": {**DUCK, "colour": [1, 2]}}}, "items/a/colour has 2 numbers: expected 3 or 4"),
        ({"items": {"a": {**DUCK, "colour": [1, 2, 0]}}}, "items/a/colour is 2: expected a number from 0 to 1"),
        ({"items": {"a": None}}, "section items/a is None: expected keys and values"),
        ({"items": [1]}, "section items is [1]: expected keys and values"),
        ({"sequence": [DUCK, {}]}, "sequence/1/urdf is missing"),
        ({"names": "ab"}, "names is 'ab': expected a list of elements"),
        ({"names": [1]}, "names/0 is 1: expected a text"),
        ({"counters": {"steps": "many"}}, "counters/steps is 'many': expected a whole number"),
        ({"kind": "rond"}, "kind is 'rond': expected one of round; did you mean round?"),
        ({"updates": -1}, "updates is -1: expected a whole number from 0"),
        ({"updates": True}, "updates is True: expected a whole number"),
        ({"updates": 10**400}, "updates is 1000"),
        ({"updates": 13}, "updates is 13: choose another number"),
        ({"finished": "yes"}, "finished is 'yes': expected true or false"),
        ({"loss": float("nan")}, "loss is nan: expected a number"),
        ([1], "the content is [1]: expected keys and values"),
    ],
)
def test_error_names_file_key_and_legal_values(values, expected):
    with pytest.raises(WorldError) as refusal:
        build(Scene, values, "a.yaml", WorldError, "see worlds/")
    message = str(refusal.value)
    assert message.startswith(f"a.yaml: {expected}")
    assert message.endswith("; see worlds/")


@pytest.mark.parametrize("text", ["1e-4", "1E-4", "1.e-4", "+1e-4", ".1e-3"])
def test_number_with_exponent_is_a_number_in_yaml(text, tmp_path):
    """PyYAML follows YAML 1.1, where an exponent needs a decimal point and a sign."""
    profile = tmp_path / "a.yaml"
    profile.write_text(f"training: {{learning_rate: {text}}}\nexploration: {{steps: 1e3}}\n")
    values = load_profile(profile)
    assert values == {"training": {"learning_rate": pytest.approx(1e-4)}, "exploration": {"steps": 1000}}


def test_date_stays_a_text():
    assert parse_yaml("2026-11-28") == "2026-11-28"


def test_name_that_looks_like_a_number_stays_a_text():
    assert build(Scene, {"names": ["1e-4"]}).names == ("1e-4",)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1:30", "1:30 is a base-60"),
        ("-1:30.5", "-1:30.5 is a base-60"),
        ("010", "010 is an octal"),
        ("-07", "-07 is an octal"),
        ("0_100", "0_100 is an octal"),
    ],
)
def test_ambiguous_yaml_numbers_are_refused(text, expected, tmp_path):
    path = tmp_path / "a.yaml"
    path.write_text(f"updates: {text}\n")
    with pytest.raises(CorruptFileError, match=rf"a\.yaml is not plain YAML \(line 1: {expected}"):
        load(Scene, path, READER)


def test_base_60_number_of_many_parts_is_refused():
    with pytest.raises(ValueError, match="a number has 1199 digits"):
        parse_yaml(":".join(["10"] * 400))


def test_text_in_quotes_may_look_like_an_ambiguous_number():
    assert parse_yaml("['1:30', '010', 0, 0.5, 0x10]") == ["1:30", "010", 0, 0.5, 16]


def test_profile_error_names_the_file(tmp_path):
    profile = tmp_path / "mine.yaml"
    profile.write_text("exploration: {stepps: 5}\n")
    with pytest.raises(
        ConfigError, match=r"mine\.yaml: unknown key exploration/stepps: did you mean exploration/steps"
    ):
        load_profile(profile)


def test_documentation_lists_sections_and_ranges():
    found = {(name, item.name): legal_values(item) for name, item in settings(Config)}
    assert found["planner", "horizon"] == "2 .. 200"
    assert found["training", "device"] == "auto | cpu | cuda"
    assert found["simulation", "world"] == ""


def test_dissimilar_name_lists_all_known_ones():
    assert suggestion("xyz", ["ergodic", "uniform"]) == "known are ergodic, uniform"


def test_unknown_registry_entry_lists_known_ones():
    with pytest.raises(ConfigError, match="unknown kind 'x': known are round"):
        KINDS["x"]
    assert KINDS["round"] is math.sin
    assert len(KINDS) == 1
