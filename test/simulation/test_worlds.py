"""The shipped worlds, and what is refused of a world file before anything starts."""

from __future__ import annotations

import importlib.util
import itertools
import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from embodied_active_learning.errors import WorldError
from embodied_active_learning.simulation import resources
from embodied_active_learning.simulation.world import Disturbances, load_world, world_names
from embodied_active_learning.workspace import Workspace

WORKSPACE = Workspace()
KINDS = {
    "bottom": ["duck", "plant"],
    "diagonal": ["duck", "plant"],
    "middle": ["duck", "plant"],
    "right": ["duck", "star"],
    "star_plant_duck": ["duck", "plant", "star"],
    "plants_ducks": ["duck", "duck", "duck", "plant", "plant"],
    "stars_ducks": ["duck", "duck", "duck", "star", "star"],
    "stars_plants": ["plant", "plant", "star", "star"],
}
DUCK = "{urdf: 'package://embodied_active_learning/worlds/models/duck/duck.urdf', position: [0.4, 0.0]}"


@pytest.fixture
def load(tmp_path):
    """Loads a world from YAML text."""

    def load_text(text):
        path = tmp_path / "mine.yaml"
        path.write_text(text, encoding="utf-8")
        return load_world(str(path), WORKSPACE)

    return load_text


@pytest.fixture
def urdf(tmp_path):
    """Writes a URDF whose visual holds the given geometry, and returns a world with it."""

    def world_with(geometry):
        text = f'<robot name="a"><link name="a"><visual><geometry>{geometry}</geometry></visual></link></robot>'
        (tmp_path / "thing.urdf").write_text(text, encoding="utf-8")
        return "objects: {thing: {urdf: thing.urdf, position: [0.4, 0.0]}}"

    return world_with


def test_the_papers_eight_workspaces_are_shipped():
    assert set(world_names()) == set(KINDS)
    for name, kinds in KINDS.items():
        assert sorted(item.kind for item in load_world(name, WORKSPACE).objects) == kinds


@pytest.mark.parametrize("name", sorted(KINDS))
def test_objects_stand_well_inside_the_workspace_and_apart_from_each_other(name):
    objects = load_world(name, WORKSPACE).objects
    positions = np.array([item.position for item in objects])
    assert np.all(np.abs(positions - WORKSPACE.centre[:2]) <= WORKSPACE.scale[:2] - 0.03)
    assert len({item.yaw for item in objects}) == len(objects)
    for first, second in itertools.combinations(positions, 2):
        assert math.dist(first, second) >= 0.12


def test_objects_are_as_large_as_things_on_a_table():
    for item in load_world("star_plant_duck", WORKSPACE).objects:
        assert 0.06 <= item.extent[:2].max() <= 0.09
        assert 0.015 <= item.extent[2] <= 0.08


def test_a_world_is_clean_unless_it_asks_for_disturbances(load):
    assert load_world("diagonal", WORKSPACE).disturbances == Disturbances()
    world = load("disturbances: {image_noise: 5, brightness_drift: 0.1, actuation_noise: [0.01, 0.01, 0.1]}")
    assert world.disturbances == Disturbances(5.0, 0.1, (0.01, 0.01, 0.1))


def test_defaults_of_an_object_are_unturned_unscaled_on_the_table(load):
    item = load(f"objects: {{a: {DUCK}}}").objects[0]
    assert (item.name, item.kind, item.yaw, item.scale, item.height, item.colour) == ("a", "duck", 0.0, 1.0, 0.0, None)


def test_kind_and_pybullet_address_are_taken_from_the_file(load):
    item = load("objects: {a: {urdf: 'pybullet_data://duck_vhacd.urdf', position: [0.4, 0], kind: bird}}").objects[0]
    assert item.kind == "bird"
    assert item.model.mesh.name == "duck.obj"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("objects: {a: {urdf: x.urdf, positon: [0.4, 0]}}", "did you mean position"),
        ("tabel: {}", "did you mean table"),
        (f"objects: {{a: {DUCK.replace('0.4', '.nan')}}}", "objects/a/position is nan"),
        (f"objects: {{a: {DUCK.replace('0.4', '.inf')}}}", "objects/a/position is inf"),
        (f"objects: {{a: {DUCK.replace('0.4', '1.4')}}}", "objects/a at .* does not stand on the table"),
        (f"objects: {{a: {DUCK.replace('0.4, 0.0', '0.4')}}}", "give 2 numbers"),
        (f"objects: {{a: {DUCK}, a: {DUCK}}}", "'a' stands twice"),
        (f"objects: {{a: {DUCK[:-1]}, scale: 0}}}}", "objects/a/scale is 0: legal is"),
        (f"objects: {{a: {DUCK[:-1]}, height: -0.1}}}}", "objects/a/height"),
        (f"objects: {{a: {DUCK[:-1]}, colour: [1, 2, 0]}}}}", "objects/a/colour is 2: legal is 0 to 1"),
        (f"objects: {{a: {DUCK[:-1]}, colour: red}}}}", "objects/a/colour is 'red': give 3 or 4 numbers"),
        (f"objects: {{a: {DUCK[:-1]}, yaw: true}}}}", "objects/a/yaw is True: give a finite number"),
        ("objects: {a: {position: [0.4, 0]}}", "objects/a/urdf is missing"),
        ("objects: {a: {urdf: gone.urdf, position: [0.4, 0]}}", "gone.urdf is missing"),
        ("objects: {a: {urdf: 'package://no_such_package/a.urdf', position: [0, 0]}}", "package no_such_package"),
        ("objects: [a, b]", "give names and values"),
        ("table: {texture: gone.png}", "there is no file .*gone.png"),
        ("table: {colour: [1, 1]}", "table/colour"),
        ("disturbances: {image_noise: -1}", "image_noise is -1"),
        ("objects: {a: [", "is not plain YAML"),
        ("just words", "is a str, expected fields"),
        ("objects: !!python/object/apply:os.getcwd []", "is not plain YAML"),
    ],
)
def test_a_world_that_cannot_be_built_is_refused_by_name(load, text, complaint):
    with pytest.raises(WorldError, match=complaint) as refusal:
        load(text)
    assert "mine.yaml" in str(refusal.value) or "gone.urdf" in complaint or "package" in complaint


@pytest.mark.parametrize(
    ("geometry", "complaint"),
    [
        ('<mesh filename="gone.obj"/>', "gone.obj is missing"),
        ('<mesh filename="thing.stl"/>', "is not an OBJ file"),
        ('<mesh filename="empty.obj"/>', "no usable vertices"),
        ('<mesh filename="empty.obj" scale="1 1"/>', "'1 1' is not 3 numbers"),
        ('<box size="1 1 1"/>', "is not a mesh"),
        ("<mesh", "is not XML"),
    ],
)
def test_a_model_that_cannot_be_shown_is_refused_with_the_name_of_its_urdf(load, urdf, tmp_path, geometry, complaint):
    (tmp_path / "empty.obj").write_text("# nothing\n", encoding="utf-8")
    with pytest.raises(WorldError, match=complaint) as refusal:
        load(urdf(geometry))
    assert "thing.urdf" in str(refusal.value)


def test_an_unknown_world_is_answered_with_the_nearest_name():
    with pytest.raises(WorldError, match="did you mean diagonal"):
        load_world("diagnal", WORKSPACE)
    with pytest.raises(WorldError, match=r"nowhere\.yaml is missing"):
        load_world("nowhere.yaml", WORKSPACE)


@pytest.mark.parametrize("variable", ["ROS_PACKAGE_PATH", "CMAKE_PREFIX_PATH"])
def test_an_installed_package_finds_its_worlds_through_the_ros_environment(monkeypatch, tmp_path, variable):
    share = tmp_path / "share"
    installed = share / "embodied_active_learning"
    (installed / "worlds").mkdir(parents=True)
    (installed / "package.xml").touch()
    monkeypatch.setattr(resources, "__file__", str(tmp_path / "lib" / "python3" / "site" / "module.py"))
    monkeypatch.delenv("ROS_PACKAGE_PATH", raising=False)
    monkeypatch.delenv("CMAKE_PREFIX_PATH", raising=False)
    with pytest.raises(WorldError, match="source the workspace"):
        resources.worlds_folder()
    monkeypatch.setenv(variable, str(share if variable == "ROS_PACKAGE_PATH" else tmp_path))
    assert resources.worlds_folder() == installed / "worlds"


def test_the_shipped_models_are_what_their_script_makes(monkeypatch, tmp_path):
    shipped = resources.worlds_folder() / "models"
    specification = importlib.util.spec_from_file_location("make_models", shipped / "make_models.py")
    script = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(script)
    monkeypatch.setattr(script, "FOLDER", tmp_path)
    script.main()
    made = sorted(path.relative_to(tmp_path) for path in tmp_path.rglob("*") if path.is_file())
    assert len(made) == 10
    for path in made:
        _assert_same_file(tmp_path / path, shipped / path)


def _assert_same_file(made: Path, shipped: Path) -> None:
    if made.suffix == ".png":
        difference = cv2.absdiff(cv2.imread(str(made)), cv2.imread(str(shipped)))
        assert difference.max() <= 1
    else:
        assert made.read_text(encoding="utf-8") == shipped.read_text(encoding="utf-8")
