"""Successes as in the paper's Table 1."""

from types import SimpleNamespace

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.evaluation import table1
from embodied_active_learning.evaluation.table1 import keep_counted, successes, table_lines
from embodied_active_learning.objects.scoring import TrueObject
from sample_decisions import make_decision

KINDS = {"object-1": "duck", "blank-1": "blank"}
OBJECTS = [
    TrueObject("duck_1", "duck", 0.4, 0.0),
    TrueObject("duck_2", "duck", 0.6, 0.1),
    TrueObject("star", "star", 0.5, -0.1),
]


def decision(name, x, y, belief, found=True):
    kind = name.split("-")[0]
    return make_decision(fingerprint=name, kind=kind, instance=int(found), pose=(x, y, 0.0), belief_mean=belief)


def test_each_object_of_a_kind_is_a_test():
    decisions = [decision("object-1", 0.41, 0.0, 0.9), decision("object-1", 0.5, -0.1, 0.8)]
    assert successes(decisions, "a", KINDS, "duck", OBJECTS) == (1, 2)
    assert successes([], "a", KINDS, "duck", OBJECTS) == (0, 2)


def test_blank_must_not_lie_on_an_object():
    assert successes([decision("blank-1", 0.45, 0.1, 0.9)], "a", KINDS, "blank", OBJECTS) == (1, 1)
    assert successes([decision("blank-1", 0.5, -0.1, 0.9)], "a", KINDS, "blank", OBJECTS) == (0, 1)


def test_ranked_rule_keeps_as_many_beliefs_as_objects():
    decisions = [decision("object-1", 0.1 * index, 0.0, belief) for index, belief in enumerate((0.2, 0.9, 0.5))]
    assert [item.belief_mean for item in keep_counted(decisions, "a", KINDS, OBJECTS)] == [0.9, 0.5]


def test_table_has_totals_beside_those_of_the_paper():
    rows = [
        {"environment": "stars_ducks", "kind": "duck", "hits": "3", "tests": "4"},
        {"environment": "stars_ducks", "kind": "star", "hits": "1", "tests": "1"},
        {"environment": "stars_ducks", "kind": "blank", "hits": "1", "tests": "1"},
        {"environment": "bottom", "kind": "duck", "hits": "1", "tests": "1"},
    ]
    assert table_lines(rows) == [
        ["environment", "duck", "star", "total", "paper"],
        ["bottom", "1/1", "0/0", "1/1 (100 %, 2-100)", "-"],
        ["stars_ducks", "3/4", "1/1", "4/5 (80 %, 28-99)", "55/70 (79 %)"],
        ["total", "4/5", "1/1", "5/6 (83 %, 36-100)", "-"],
    ]


def test_model_is_measured_by_both_rules(monkeypatch):
    """The duck is found by views; the plant's place has a higher belief."""
    duck, plant = table1.true_objects(config_of("diagonal"))
    kinds = [Fake("object-1", duck), Fake("blank-1", TrueObject("blank", "blank", 0.5, 0.0))]
    monkeypatch.setattr(table1, "ensure_fingerprints", lambda session: SimpleNamespace(fingerprints=kinds))

    def identify(model, images_of, images, name, overwrite, **settings):
        assert settings["evidence"] == "counted"
        right, wrong = decision("object-1", duck.x, duck.y, 0.8), decision("object-1", plant.x, plant.y, 0.9)
        return [wrong, right] if settings.get("decision") == "belief" else [right]

    monkeypatch.setattr(table1, "identify", identify)
    config = Config.from_dict({"simulation": {"world": "diagonal"}, "identification": {"evidence": "counted"}})
    session = SimpleNamespace(name="a", config=config)
    rows = [tuple(row.values()) for row in table1.measure(session, session, 10)]
    assert rows == [
        ("ranked", "blank", 0, 1),
        ("ranked", "duck", 0, 1),
        ("decided", "blank", 0, 1),
        ("decided", "duck", 1, 1),
    ]


class Fake:
    """A fingerprint at the place of an object."""

    def __init__(self, name, place):
        self.name, self.kind = name, name.split("-")[0]
        self.centre = np.array([place.x, place.y, 0.0])


def config_of(world):
    return Config.from_dict({"simulation": {"world": world}})
