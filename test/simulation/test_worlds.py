"""World files: the shipped ones, and rejection of invalid ones before anything starts."""

from __future__ import annotations

import importlib.util
import itertools
import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.errors import WorldError
from embodied_active_learning.simulation import resources
from embodied_active_learning.simulation.scene import Scene
from embodied_active_learning.simulation.world import DEFAULT_TEXTURE, Disturbances, load_world, world_names
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
    "other_table": ["duck", "plant", "toy"],
    "stars_plants": ["plant", "plant", "star", "star"],
}
DUCK = "{urdf: 'package://embodied_active_learning/worlds/models/duck/duck.urdf', position: [0.4, 0.0]}"


@pytest.fixture
def load(tmp_path):
    """Load a world from YAML text."""

    def load_text(text):
        path = tmp_path / "mine.yaml"
        path.write_text(text, encoding="utf-8")
        return load_world(str(path), WORKSPACE)

    return load_text


def test_workspaces_of_paper_and_demo_are_shipped():
    assert set(world_names()) == set(KINDS)
    for name, kinds in KINDS.items():
        assert sorted(item.kind for item in load_world(name, WORKSPACE).objects) == kinds


@pytest.mark.parametrize("name", sorted(KINDS))
def test_shipped_objects_are_inside_workspace_and_apart(name):
    objects = load_world(name, WORKSPACE).objects
    positions = np.array([item.position for item in objects])
    assert np.all(np.abs(positions - WORKSPACE.centre[:2]) <= WORKSPACE.scale[:2] - 0.03)
    assert len({item.yaw for item in objects}) == len(objects)
    for first, second in itertools.combinations(positions, 2):
        assert math.dist(first, second) >= 0.12


def test_shipped_objects_have_plausible_size():
    for item in load_world("star_plant_duck", WORKSPACE).objects:
        assert 0.06 <= item.extent[:2].max() <= 0.09
        assert 0.015 <= item.extent[2] <= 0.08


def test_disturbances_are_off_by_default(load):
    assert load_world("diagonal", WORKSPACE).disturbances == Disturbances()
    world = load("disturbances: {image_noise: 5, brightness_drift: 0.1, actuation_noise: [0.01, 0.01, 0.1]}")
    assert world.disturbances == Disturbances(5.0, 0.1, (0.01, 0.01, 0.1))


def test_object_defaults(load):
    item = load(f"objects: {{a: {DUCK}}}").objects[0]
    assert (item.name, item.kind, item.yaw, item.scale, item.height, item.colour) == ("a", "duck", 0.0, 1.0, 0.0, None)


def test_kind_and_pybullet_address_are_used(load):
    item = load("objects: {a: {urdf: 'pybullet_data://duck_vhacd.urdf', position: [0.4, 0], kind: bird}}").objects[0]
    assert item.kind == "bird"
    assert item.model.mesh.name == "duck.obj"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("tabel: {}", "did you mean table"),
        (f"objects: {{a: {DUCK.replace('0.4', '.nan')}}}", "objects/a/position is nan"),
        (f"objects: {{a: {DUCK.replace('0.4', '1.4')}}}", "objects/a at .* does not stand on the table"),
        (f"objects: {{a: {DUCK}, a: {DUCK}}}", "duplicate key 'a'"),
        (f"objects: {{a: {DUCK[:-1]}, scale: 0}}}}", "objects/a/scale is 0: expected a number from 1e-06"),
        (f"objects: {{a: {DUCK[:-1]}, height: -0.1}}}}", "objects/a/height"),
        (f"objects: {{a: {DUCK[:-1]}, colour: [1, 2, 0]}}}}", "objects/a/colour is 2: expected a number from 0 to 1"),
        (f"objects: {{a: {DUCK[:-1]}, colour: red}}}}", "objects/a/colour is 'red': expected a list of 3 or 4 numbers"),
        ("objects: {a: {urdf: gone.urdf, position: [0.4, 0]}}", "gone.urdf is missing"),
        ("objects: {a: {urdf: random_urdfs/1042, position: [0.4, 0]}}", "random_urdfs/000 to /999"),
        ("objects: {a: {}}", f"see the shipped worlds in {resources.worlds_folder()}"),
        ("objects: {a: {urdf: 'package://no_such_package/a.urdf', position: [0, 0]}}", "package no_such_package"),
        ("table: {texture: gone.png}", "gone.png is missing"),
        ("table: {colour: [1, 1]}", "table/colour"),
        ("disturbances: {image_noise: -1}", "image_noise is -1"),
        ("lighting: {shadow: 2}", "lighting/shadow is 2: expected a number from 0 to 1"),
        ("table: {generate: {kind: would, seed: 3}}", "table/generate/kind is 'would': expected one of .* wood"),
        ("table: {generate: {kind: wood}, colour: [1, 1, 1]}", "give only one of texture, colour and generate"),
        (f"objects: {{a: {DUCK[:-1]}, yaw: 90}}}}", "yaw is 90: expected a number from -6.28.* to 6.28.* rad"),
        (f"objects: {{a: {DUCK[:-1]}, scale: 1, size: 0.08}}}}", "objects/a: give only one of scale and size"),
        (f"objects: {{a: {DUCK[:-1]}, colour: [1, 0, 0, 0.5]}}}}", "transparent objects are not supported"),
        (f"objects: {{a: {DUCK[:-1]}, scale: 1000}}}}", "objects/a measures 82.* m: is its model in millimetres"),
        (f"objects: {{a: {DUCK[:-1]}, scale: 0.001}}}}", "objects/a measures .* Set size"),
        (f"objects: {{a: {DUCK}, b: {DUCK.replace('0.4', '0.405')}}}", "a and objects/b overlap, .* 5 mm apart"),
    ],
)
def test_invalid_world_is_rejected_with_file_and_key(load, text, complaint):
    with pytest.raises(WorldError, match=complaint) as rejection:
        load(text)
    assert "mine.yaml" in str(rejection.value) or "gone.urdf" in complaint or "package" in complaint


def test_world_is_loaded_from_path_object(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(f"objects: {{a: {DUCK}}}")
    assert load_world(path, WORKSPACE) == load_world(str(path), WORKSPACE)


def test_slight_overlap_is_logged(load, caplog):
    load(f"objects: {{a: {DUCK}, b: {DUCK.replace('0.0]', '0.05]')}}}")
    assert "objects/a and objects/b overlap, their centres are 50 mm apart" in caplog.text


def test_object_above_another_does_not_overlap(load, caplog):
    load(f"objects: {{a: {DUCK}, b: {DUCK[:-1]}, height: 0.08}}}}")
    assert caplog.text == ""


@pytest.mark.parametrize("extra", ["scale: 3.5", "height: 0.2", "height: 0.31"])
def test_object_reaching_the_camera_is_rejected(tmp_path, extra):
    path = tmp_path / "mine.yaml"
    path.write_text(f"objects: {{a: {DUCK[:-1]}, {extra}}}}}")
    load_world(path, WORKSPACE)
    with pytest.raises(WorldError, match=r"mine.yaml: objects/a reaches .* cm above the table, the camera is at 30.0"):
        load_world(path, WORKSPACE, CameraConfig())
    load_world(path, WORKSPACE, CameraConfig(distance=0.5))


def test_object_out_of_view_is_logged(tmp_path, caplog):
    """The camera sees 8 cm of the table on each side, 11 cm along its diagonal."""
    path = tmp_path / "mine.yaml"
    path.write_text(f"objects: {{a: {DUCK.replace('0.4, 0.0', '0.4, 0.29')}}}")
    load_world(path, WORKSPACE, CameraConfig())
    assert caplog.text == ""
    path.write_text(f"objects: {{a: {DUCK.replace('0.4, 0.0', '0.4, 0.34')}}}")
    load_world(path, WORKSPACE, CameraConfig())
    assert "objects/a at [0.4, 0.34] is never in the camera's view: move it into the workspace" in caplog.text


def test_object_without_colour_is_logged(tmp_path, caplog):
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 0.05 0 0\nv 0 0.05 0\nf 1 2 3\n")
    mesh = '<visual><geometry><mesh filename="a.obj"/></geometry></visual>'
    (tmp_path / "a.urdf").write_text(f'<robot name="a"><link name="a">{mesh}</link></robot>')
    path = tmp_path / "mine.yaml"
    path.write_text("objects: {a: {urdf: a.urdf, position: [0.4, 0.0], colour: [1, 0, 0]}}")
    load_world(path, WORKSPACE)
    assert caplog.text == ""
    path.write_text("objects: {a: {urdf: a.urdf, position: [0.4, 0.0]}}")
    load_world(path, WORKSPACE)
    assert "objects/a is rendered white" in caplog.text


def test_number_of_objects_is_limited(load):
    with pytest.raises(WorldError, match="201 objects: at most 200"):
        load("objects:\n" + "\n".join(f"  a{number}: {DUCK}" for number in range(201)))


def test_table_of_one_colour_is_logged(tmp_path, caplog):
    """The planner holds the arm for images of one colour."""
    path = tmp_path / "mine.yaml"
    path.write_text("table: {colour: [1, 1, 1]}")
    load_world(path, WORKSPACE, CameraConfig(allow_featureless=True))
    assert caplog.text == ""
    load_world(path, WORKSPACE, CameraConfig())
    assert "the table of world mine has one colour" in caplog.text


def test_default_table_is_plain_but_not_featureless(load):
    table = load("objects: {}").table
    assert table.generated == DEFAULT_TEXTURE
    scene = Scene(load("objects: {}"), CameraConfig())
    images = [scene.render((x, 0.0, 0.0)) for x in (0.4, 0.5)]
    scene.close()
    assert images[0].std(axis=(0, 1)).min() > 0.5
    assert images[0].max() < 230, "no room for brighter light"
    assert not np.array_equal(*images)


def test_procedural_object_is_loaded_by_name_and_size(load):
    (item,) = load("objects: {a: {urdf: random_urdfs/000, position: [0.4, 0.0], size: 0.08}}").objects
    assert item.kind == "random_000"
    assert item.extent.max() == pytest.approx(0.08)
    assert item.rgb == (0.04, 0.07, 0.91)


def test_unknown_world_suggests_nearest_name():
    with pytest.raises(WorldError, match="did you mean diagonal"):
        load_world("diagnal", WORKSPACE)
    with pytest.raises(WorldError, match=r"nowhere\.yaml is missing"):
        load_world("nowhere.yaml", WORKSPACE)


@pytest.mark.parametrize("variable", ["ROS_PACKAGE_PATH", "CMAKE_PREFIX_PATH"])
def test_installed_package_finds_its_worlds(monkeypatch, tmp_path, variable):
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


def test_shipped_models_match_their_script(monkeypatch, tmp_path):
    shipped = resources.worlds_folder() / "models"
    specification = importlib.util.spec_from_file_location("make_models", shipped / "make_models.py")
    script = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(script)
    monkeypatch.setattr(script, "FOLDER", tmp_path)
    script.main([])
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
