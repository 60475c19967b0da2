"""Scene: the simulated camera sees objects where they stand, with their rotation and colour."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from embodied_active_learning.config import CameraConfig, Config
from embodied_active_learning.errors import WorldError
from embodied_active_learning.geometry import optical_rotation
from embodied_active_learning.simulation import scene as scene_module
from embodied_active_learning.simulation.scene import Scene
from embodied_active_learning.simulation.truth import true_objects, true_scene
from embodied_active_learning.simulation.world import load_world, world_names
from embodied_active_learning.workspace import Workspace

WORKSPACE = Workspace()
CENTRE = WORKSPACE.centre[:2]
POSES = [(0.475, 0.0, 0.0), (0.47, 0.01, 1.3), (0.49, -0.02, -2.0), (0.46, 0.015, 3.0)]


@pytest.fixture
def scene(tmp_path):
    """Build scenes from YAML text; the URDF of a red disc (12 mm across, flat) is next to it."""
    angles = 2.0 * np.pi * np.arange(48) / 48
    rim = [f"v {0.006 * math.cos(angle):.7f} {0.006 * math.sin(angle):.7f} 0" for angle in angles]
    faces = [f"f 1//1 {2 + i}//1 {2 + (i + 1) % 48}//1" for i in range(48)]
    (tmp_path / "disc.obj").write_text("\n".join(["v 0 0 0", *rim, "vn 0 0 1", *faces]) + "\n", encoding="utf-8")
    (tmp_path / "disc.urdf").write_text(
        '<robot name="disc"><link name="disc"><visual><geometry><mesh filename="disc.obj"/></geometry>'
        '<material name="red"><color rgba="1 0 0 1"/></material></visual></link></robot>',
        encoding="utf-8",
    )
    built = []

    def build(text, **camera):
        (tmp_path / "mine.yaml").write_text(text, encoding="utf-8")
        built.append(Scene(load_world(str(tmp_path / "mine.yaml"), WORKSPACE), CameraConfig(**camera)))
        return built[-1]

    yield build
    for item in built:
        item.close()


def discs(*places):
    """Return a blue table with red discs at (x, y, height)."""
    lines = [f"  d{i}: {{urdf: disc.urdf, position: [{x}, {y}], height: {z}}}" for i, (x, y, z) in enumerate(places)]
    return "\n".join(["table: {colour: [0, 0, 1]}", "objects:", *lines])


def reddish(image):
    return image[:, :, 0].astype(int) > image[:, :, 2]


def centre_of(weights):
    """Return the centroid (u, v) of a mask or image (H, W)."""
    rows, columns = np.indices(weights.shape)
    return np.array([(columns * weights).sum(), (rows * weights).sum()]) / weights.sum()


def project(scene, pose, point, height=0.3):
    """Return the pixel (u, v) of a point (3,) in the base frame."""
    in_camera = optical_rotation(pose[2]).T @ (np.asarray(point) - [pose[0], pose[1], height])
    pixel = scene.intrinsics() @ in_camera
    return pixel[:2] / pixel[2]


@pytest.mark.parametrize("size", [(180, 180), (201, 120)])
@pytest.mark.parametrize("pose", POSES)
def test_object_is_rendered_where_camera_matrix_projects_it(scene, size, pose):
    width, height = size
    for place in ((0.475, 0.0, 0.0), (0.493, -0.011, 0.05), (0.462, 0.017, 0.02)):
        view = scene(discs(place), width=width, height=height)
        mask = reddish(view.render(pose))
        assert 50 < mask.sum() < 400
        np.testing.assert_allclose(centre_of(mask), project(view, pose, place), atol=0.2)


def test_image_axes_at_yaw_zero(scene):
    view = scene(discs((0.505, 0.0, 0.0), (0.475, 0.045, 0.0)))
    mask = reddish(view.render((0.475, 0.0, 0.0)))
    assert mask[80:100, 115:130].any()
    assert mask[:50, 80:100].any()
    assert not mask[:, :80].any()
    assert not mask[100:].any()


def test_camera_yaw_rotates_image_the_other_way(scene):
    view = scene(discs((0.505, 0.0, 0.0)))
    u, v = centre_of(reddish(view.render((0.475, 0.0, math.pi / 2))))
    assert u == pytest.approx(89.5, abs=0.3)
    assert v > 120


def test_table_texture_is_where_camera_matrix_projects_it(scene, tmp_path):
    texture = np.zeros((400, 500, 3), dtype=np.uint8)
    texture[:, :, 0] = 255  # OpenCV's blue
    texture[190:200, 260:270] = (0, 0, 255)
    cv2.imwrite(str(tmp_path / "texture.png"), texture)
    view = scene("table: {texture: texture.png, centre: [0.5, 0.0], size: [0.5, 0.4]}")
    point = (0.5 + (265 - 250) * 1e-3, (200 - 195) * 1e-3, 0.0)
    for pose in POSES:
        red = view.render(pose)[:, :, 0].astype(float)
        np.testing.assert_allclose(centre_of(red), project(view, pose, point), atol=0.05)


def test_floor_is_visible_beyond_table(scene):
    view = scene("table: {colour: [0, 0, 1], size: [0.1, 0.1]}")
    image = view.render((0.475, 0.0, 0.0))
    assert tuple(image[90, 90]) == (0, 0, 255)
    assert tuple(image[2, 2]) == (96, 94, 92)


@pytest.mark.parametrize("yaw", [0.0, math.pi / 2, math.pi])
@pytest.mark.parametrize("kind", ["duck", "plant", "star"])
def test_position_is_centre_of_mesh(scene, kind, yaw):
    address = f"package://embodied_active_learning/worlds/models/{kind}/{kind}.urdf"
    view = scene(
        f"table: {{colour: [0, 0, 1]}}\nobjects: {{a: {{urdf: '{address}', position: [0.49, 0.02], yaw: {yaw}}}}}"
    )
    image = view.top_view(CENTRE, 0.3, 600)
    rows, columns = np.nonzero(np.any(image != (0, 0, 255), axis=2))
    middle = np.array([columns.min() + columns.max(), rows.min() + rows.max()]) / 2.0
    # Half a millimetre per pixel; an object 8 cm high looks 4 % larger from 2 m.
    np.testing.assert_allclose(middle, [299.5 + 30.0, 299.5 - 40.0], atol=5.0)
    size = np.array([np.ptp(columns), np.ptp(rows)]) * 0.5e-3
    expected = view.objects[0].extent[:2] if yaw != math.pi / 2 else view.objects[0].extent[1::-1]
    np.testing.assert_allclose(size, expected, rtol=0.06)


def test_unknown_truth_is_an_error_for_measurements_only(tmp_path):
    config = Config.from_dict({"simulation": {"world": str(tmp_path / "gone.yaml")}})
    with pytest.raises(WorldError, match=r"gone\.yaml"):
        true_objects(config)
    assert true_scene(config).objects == ()


def test_true_objects_match_world():
    world = load_world("star_plant_duck", WORKSPACE)
    view = Scene(world, CameraConfig())
    assert [(item.name, item.kind, item.centre, item.yaw) for item in view.objects] == [
        (item.name, item.kind, item.position, item.yaw) for item in world.objects
    ]
    view.close()


def test_shipped_objects_have_their_colours():
    view = Scene(load_world("star_plant_duck", WORKSPACE), CameraConfig())
    for item in view.objects:
        image = view.render((*item.centre, 0.0))
        red, green, blue = image[70:110, 70:110].reshape(-1, 3).mean(axis=0)
        if item.kind == "duck":
            assert red > 150
            assert blue < 60
            assert green > 120
        elif item.kind == "plant":
            assert green > 1.3 * red
            assert green > 1.3 * blue
        else:
            assert red > 4 * green
    view.close()


@pytest.mark.parametrize("name", ["star_plant_duck", "right"])
def test_rotated_objects_look_different(name):
    view = Scene(load_world(name, WORKSPACE), CameraConfig())
    for item in view.objects:
        looks = [view.render((*item.centre, 0.4 * math.pi * turn)).astype(float) for turn in range(5)]
        for look in looks[1:]:
            assert np.abs(look - looks[0]).mean() > 1.0
    view.close()


def test_colour_in_world_file_is_applied(scene):
    text = discs((0.475, 0.0, 0.0)).replace("height:", "colour: [0, 1, 0], height:")
    image = scene(text).render((0.475, 0.0, 0.0))
    assert image[90, 90, 1] > 200
    assert image[90, 90, 0] == 0


def test_rendering_is_deterministic_across_scenes():
    world = load_world("stars_ducks", WORKSPACE)
    first, second = Scene(world, CameraConfig()), Scene(world, CameraConfig())
    image = first.render((0.47, 0.01, 0.7))
    first.render((0.4, 0.1, -1.0))
    np.testing.assert_array_equal(first.render((0.47, 0.01, 0.7)), image)
    first.close()
    np.testing.assert_array_equal(second.render((0.47, 0.01, 0.7)), image)
    second.close()


def assert_culling_changes_nothing(view, poses, monkeypatch):
    """Compare images of all poses with those for which every object is rendered."""
    pictures = [view.render(pose) for pose in poses]
    with monkeypatch.context() as patch:
        patch.setattr(scene_module, "_in_view", lambda boxes, *_: [True] * len(boxes))
        for pose, picture in zip(poses, pictures):
            np.testing.assert_array_equal(view.render(pose), picture)


@pytest.mark.parametrize("name", world_names())
def test_culling_changes_no_pixel(name, monkeypatch):
    world, generator = load_world(name, WORKSPACE), np.random.default_rng(0)
    view = Scene(world, CameraConfig())
    anywhere = generator.uniform(WORKSPACE.lower, WORKSPACE.upper, (30, 3))
    assert_culling_changes_nothing(view, anywhere, monkeypatch)
    view.close()


@pytest.mark.parametrize("direction", [(1, 0), (-1, 0), (0, 1), (0, -1)])
def test_object_is_rendered_until_its_last_pixel_is_out(scene, direction, monkeypatch):
    view = scene(discs((0.475, 0.0, 0.02)))
    # From 20 mm above the table the picture's edge is 75 mm off; the disc has a radius of 6 mm.
    distances = np.arange(0.078, 0.084, 1e-4)
    poses = [(0.475 + direction[0] * distance, direction[1] * distance, 0.0) for distance in distances]
    seen = [reddish(view.render(pose)).any() for pose in poses]
    assert seen[0]
    assert not seen[-1]
    assert_culling_changes_nothing(view, poses, monkeypatch)


def test_object_keeps_colour_after_culling(scene):
    text = discs((0.475, 0.0, 0.0)).replace("height:", "colour: [0.2, 0.9, 0.1], height:")
    view = scene(text)
    picture = view.render((0.475, 0.0, 0.0))
    blue = view.render((0.6, 0.1, 0.0))
    assert np.all(blue == (0, 0, 255))
    view.render((0.475, 0.0, 1.0))
    np.testing.assert_array_equal(view.render((0.475, 0.0, 0.0)), picture)


def test_empty_table_needs_no_renderer(scene, monkeypatch):
    view = scene(discs((0.475, 0.0, 0.0)))
    monkeypatch.delattr(scene_module.pybullet, "getCameraImage")
    assert np.all(view.render((0.6, 0.1, 0.0)) == (0, 0, 255))
    with pytest.raises(AttributeError):
        view.render((0.475, 0.0, 0.0))


def test_image_format(scene):
    image = scene(discs((0.475, 0.0, 0.0)), width=64, height=48).render((0.475, 0.0, 0.0))
    assert image.shape == (48, 64, 3)
    assert image.dtype == np.uint8
    assert image.flags.c_contiguous


def test_invalid_texture_is_rejected(scene, tmp_path):
    (tmp_path / "texture.png").write_text("no image", encoding="utf-8")
    with pytest.raises(
        WorldError,
        match=r"texture.png has an unsupported format .it begins with 6e 6f 20 69, .*; convert it to PNG",
    ):
        scene("table: {texture: texture.png}")
