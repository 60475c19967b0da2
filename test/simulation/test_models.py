"""Object models: what URDF, OBJ and MTL files define is rendered as defined, or rejected with the remedy."""

import os
import zlib
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.errors import WorldError
from embodied_active_learning.simulation.scene import Scene
from embodied_active_learning.simulation.world import load_world
from embodied_active_learning.workspace import Workspace

WORKSPACE = Workspace()
CORNERS = [(x, y, z) for z in (0.0, 0.04) for x, y in ((-0.03, -0.02), (0.03, -0.02), (0.03, 0.02), (-0.03, 0.02))]
FACES = [(1, 4, 3, 2), (5, 6, 7, 8), (1, 2, 6, 5), (2, 3, 7, 6), (3, 4, 8, 7), (4, 1, 5, 8)]
TOP = 1  # index of the face that points up
RED, GREEN = np.array([0.85, 0.1, 0.1]), np.array([0.16, 0.78, 0.16])


def write_obj(folder, head="", use="", faces=FACES, scale=(1, 1, 1), more=(), colours=None):
    """Write thing.obj, a box of 6 x 4 x 4 cm, with one texture coordinate for each corner of a face."""
    points = [*CORNERS, *more]
    lines = [head] if head else []
    for index, point in enumerate(points):
        colour = "" if colours is None else " {:.3f} {:.3f} {:.3f}".format(*colours[index])
        lines.append("v " + " ".join(f"{c * s:.6f}" for c, s in zip(point, scale)) + colour)
    lines += ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1", *([f"usemtl {use}"] if use else [])]
    lines += ["f " + " ".join(f"{corner}/{index + 1}" for index, corner in enumerate(face)) for face in faces]
    (folder / "thing.obj").write_text("\n".join(lines) + "\n")


def write_urdf(folder, material="", top="", mesh='filename="thing.obj"'):
    (folder / "thing.urdf").write_text(
        f'<robot name="thing">{top}<link name="body"><visual><geometry><mesh {mesh}/></geometry>{material}</visual>'
        "</link></robot>"
    )


def write_picture(path, colour=GREEN, dtype=np.uint8):
    scale = np.iinfo(dtype).max
    cv2.imwrite(str(path), np.full((32, 32, 3), scale * colour[::-1]).astype(dtype))


def world(folder, **values):
    keys = "".join(f", {key}: {value}" for key, value in values.items())
    text = f"table: {{colour: [0.2, 0.2, 0.2]}}\nobjects: {{thing: {{urdf: thing.urdf, position: [0.475, 0.0]{keys}}}}}"
    (folder / "mine.yaml").write_text(text)
    return load_world(folder / "mine.yaml", WORKSPACE, CameraConfig())


def image(folder, **values):
    scene = Scene(world(folder, **values), CameraConfig())
    found = scene.render((0.475, 0.0, 0.0)).astype(float)
    scene.close()
    return found


def look(folder, **values):
    """Return the colour (3,) of the top face, as a share of white light, and the size (2,) of the object in pixels."""
    found = image(folder, **values)
    rows, columns = np.nonzero(np.abs(found - 51.0).max(axis=2) > 10.0)
    return found[85:95, 85:95].mean(axis=(0, 1)) / 255.0, np.array([np.ptp(columns), np.ptp(rows)]) + 1


def assert_coloured(folder, expected, **values):
    """The renderer shades colours: compare hue and saturation with a tolerance, and brightness loosely."""
    colour, size = look(folder, **values)
    np.testing.assert_allclose(colour / colour.max(), expected / expected.max(), atol=0.04)
    assert colour.max() > 0.5 * expected.max()
    np.testing.assert_allclose(size, [78, 52], atol=2)  # 6 x 4 cm, 4 cm closer than the table


def rejection(folder, **values):
    with pytest.raises(WorldError) as error:
        world(folder, **values)
    assert "mine.yaml: objects/thing" in str(error.value)
    return str(error.value)


RGBA = '<color rgba="0.85 0.1 0.1 1"/>'


@pytest.mark.parametrize(
    ("material", "top"),
    [
        (f'<material name="red">{RGBA}</material>', ""),
        ('<material name="red"/>', f'<material name="red">{RGBA}</material>'),
    ],
    ids=["inline", "named"],
)
def test_colour_of_urdf_is_rendered(tmp_path, material, top):
    write_obj(tmp_path)
    write_urdf(tmp_path, material, top)
    assert_coloured(tmp_path, RED)


def test_colour_of_mtl_is_rendered(tmp_path):
    (tmp_path / "thing.mtl").write_text("newmtl red\nKd 0.85 0.10 0.10\n")
    write_obj(tmp_path, "mtllib thing.mtl", "red")
    write_urdf(tmp_path)
    assert_coloured(tmp_path, RED)


def test_texture_of_urdf_is_rendered(tmp_path):
    write_picture(tmp_path / "green.png")
    write_obj(tmp_path)
    write_urdf(tmp_path, '<material name="t"><texture filename="green.png"/></material>')
    assert_coloured(tmp_path, GREEN)


@pytest.mark.parametrize(
    ("entry", "library"),
    [
        ("green.png", "thing.mtl"),
        ("-s 1 1 1 green.png", "thing.mtl"),
        ("-clamp on -blendu off green.png", "thing.mtl"),
        ("my green box.png", "thing.mtl"),
        ("green.png", "my box.mtl"),
        ("textures/green.png", "thing.mtl"),
    ],
)
def test_texture_of_mtl_is_rendered(tmp_path, entry, library):
    (tmp_path / "textures").mkdir()
    for name in ("green.png", "my green box.png", "textures/green.png"):
        write_picture(tmp_path / name)
    (tmp_path / library).write_text(f"newmtl g\nKd 1 1 1\nmap_Kd {entry}\n")
    write_obj(tmp_path, f"mtllib {library}", "g")
    write_urdf(tmp_path)
    assert_coloured(tmp_path, GREEN)


def test_texture_with_16_bits_is_rendered(tmp_path):
    write_picture(tmp_path / "deep.png", dtype=np.uint16)
    (tmp_path / "thing.mtl").write_text("newmtl g\nmap_Kd deep.png\n")
    write_obj(tmp_path, "mtllib thing.mtl", "g")
    write_urdf(tmp_path)
    assert_coloured(tmp_path, GREEN)


def test_colours_of_several_materials_are_rendered(tmp_path):
    """Each face has the colour of its material."""
    (tmp_path / "thing.mtl").write_text("newmtl red\nKd 0.85 0.1 0.1\nnewmtl green\nKd 0.16 0.78 0.16\n")
    write_obj(tmp_path, "mtllib thing.mtl", "green")
    lines = (tmp_path / "thing.obj").read_text().splitlines()
    top = next(index for index, line in enumerate(lines) if line.startswith("f 5/"))
    lines[top : top + 1] = ["usemtl red", lines[top], "usemtl green"]
    (tmp_path / "thing.obj").write_text("\n".join(lines))
    write_urdf(tmp_path)
    assert_coloured(tmp_path, RED)
    assert_coloured(tmp_path, np.array([0.0, 0.0, 1.0]), colour="[0, 0, 1]")


def test_vertex_colours_are_rendered(tmp_path):
    write_obj(tmp_path, colours=[GREEN] * 4 + [RED] * 4)
    write_urdf(tmp_path)
    assert_coloured(tmp_path, RED)


def test_missing_material_file_is_logged_if_urdf_has_colour(tmp_path, caplog):
    write_obj(tmp_path, "mtllib gone.mtl", "g")
    write_urdf(tmp_path, f'<material name="red">{RGBA}</material>')
    assert_coloured(tmp_path, RED)
    assert "gone.mtl is missing: using the colour of the URDF" in caplog.text


def test_unusual_obj_syntax_is_accepted(tmp_path):
    """Tabs, indentation, Windows line ends, comments, continued lines, relative and missing indices, forward use."""
    lines = ["# box", "f 1 4 3 2", *(f"  v\t{x}\t{y}\t{z} " for x, y, z in CORNERS), "o box", "s off", "l 1 2"]
    lines += ["f -4 -3 -2 -1", *(f"f {' '.join(f'{corner}//' for corner in face)}" for face in FACES[2:5])]
    lines += ["f 4 1 \\", "5 8", "f 1 2"]
    (tmp_path / "thing.obj").write_bytes("\r\n".join(lines).encode())
    write_urdf(tmp_path, f'<material name="red">{RGBA}</material>')
    assert_coloured(tmp_path, RED)


def test_bounding_box_ignores_unused_vertices(tmp_path):
    write_obj(tmp_path, more=[(0.2, 0.2, 0.1)])
    write_urdf(tmp_path)
    (item,) = world(tmp_path).objects
    np.testing.assert_allclose(item.extent, [0.06, 0.04, 0.04])
    assert_coloured(tmp_path, np.ones(3))


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ({"thing.mtl": "newmtl g\nmap_Kd gone.png"}, "its texture .*gone.png is missing: copy it there"),
        ({"thing.mtl": "newmtl g\nmap_Kd textures\\green.png"}, r"is missing \(a Windows path\? use / in it\)"),
        ({"thing.mtl": "newmtl g\nmap_Kd C:\\green.png"}, r"is missing \(a Windows path"),
        ({"thing.mtl": "newmtl g\nmap_Kd -s 2 2 1 green.png"}, "texture option -s is not supported"),
        ({"thing.mtl": "newmtl g\nmap_Kd -warp green.png"}, "unknown texture option '-warp'"),
        ({"thing.mtl": "newmtl g\nmap_Kd"}, "map_Kd names no texture file"),
        ({"thing.mtl": "newmtl g\nKd 0.5 red"}, "invalid colour Kd '0.5 red'"),
        ({"thing.mtl": "newmtl other"}, "uses the material 'g', its material files define other"),
        ({}, "its material file thing.mtl is missing: copy it"),
        ({"thing.mtl": "version https://git-lfs.github.com/spec/v1\n"}, "Git LFS pointer, .*: run `git lfs pull`"),
        (
            {"thing.mtl": "newmtl g\nmap_Kd p.png", "p.png": "version https://git-lfs.github.com/spec/v1\n"},
            "p.png is a Git LFS pointer",
        ),
        (
            {"thing.mtl": "newmtl g\nmap_Kd p.png", "p.png": "GIF89a"},
            "p.png has an unsupported format .*JPEG or PNG",
        ),
        ({"thing.mtl": "newmtl g\nmap_Kd p.png", "p.png": "\x89"}, "p.png has an unsupported format"),
    ],
)
def test_unusable_material_is_rejected(tmp_path, files, words):
    write_obj(tmp_path, "mtllib thing.mtl", "g")
    write_urdf(tmp_path)
    for name, content in files.items():
        (tmp_path / name).write_text(content)
    with pytest.raises(WorldError, match=words):
        world(tmp_path)


def test_several_textures_are_rejected(tmp_path):
    for name in ("a.png", "b.png"):
        write_picture(tmp_path / name)
    (tmp_path / "thing.mtl").write_text("newmtl a\nmap_Kd a.png\nnewmtl b\nmap_Kd b.png\n")
    write_obj(tmp_path, "mtllib thing.mtl", "a", faces=FACES[:3])
    with (tmp_path / "thing.obj").open("a") as stream:
        stream.write("usemtl b\nf 2/1 3/2 7/3 6/4\n")
    write_urdf(tmp_path)
    assert "has several textures (a.png, b.png): bake them into one" in rejection(tmp_path)


@pytest.mark.parametrize(
    ("material", "top", "words"),
    [
        ('<material name="red"/>', "", "material 'red' is not defined"),
        ('<material name="red"/>', '<material name="red"/>', "has neither color nor texture"),
        ('<material><color rgba="1 0 0"/></material>', "", "'1 0 0' is not 4 numbers"),
        ('<material><color rgba="255 0 0 1"/></material>', "", "rgba '255 0 0 1' is out of range"),
        ('<material><color rgba="1 0 0 0"/></material>', "", "is invisible: set its opacity"),
        ('<material><texture filename="gone.png"/></material>', "", "gone.png is missing"),
    ],
)
def test_unusable_urdf_material_is_rejected(tmp_path, material, top, words):
    write_obj(tmp_path)
    write_urdf(tmp_path, material, top)
    assert words in rejection(tmp_path)


def test_texture_without_coordinates_is_rejected(tmp_path):
    write_picture(tmp_path / "green.png")
    (tmp_path / "thing.obj").write_text("v 0 0 0\nv 0.05 0 0\nv 0 0.05 0\nf 1 2 3\n")
    write_urdf(tmp_path, '<material><texture filename="green.png"/></material>')
    assert "faces without texture coordinates: unwrap it" in rejection(tmp_path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("v 0 0 0\nv 1 0 0\nv 0 1 0", "has no faces, only 3 vertices: export it with faces"),
        ("f 1 2 3", "has no vertices"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4", "a face refers to number 4 of 3 vertices"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/9 2/1 3/1", "of 0 texture coordinates"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1//1 2//1 3//1", "of 0 normals"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf -4 -1 -2", "index -4 is out of range, there are 3 so far"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2", "index 0 is out of range"),
        (f"v 0 0 0\nv 1 0 0\nv 0 1 0\nf {2**70} 1 2", "is out of range"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 x", "line 4, 'f 1 2 x'"),
        ("v 0 0", "line 1, 'v 0 0': expected 3 numbers"),
        ("v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3", "a vertex is not finite"),
        ("v 0 0 1e39\nv 1 0 0\nv 0 1 0\nf 1 2 3", "a vertex is not finite"),
        ("v 0 0 1_0\nv 1 0 0\nv 0 1 0\nf 1 2 3", "a vertex is invalid: not a plain number"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt x\nf 1/1 2/1 3/1", "a texture coordinate is invalid"),
    ],
)
def test_malformed_mesh_is_rejected(tmp_path, text, words):
    (tmp_path / "thing.obj").write_text(text)
    write_urdf(tmp_path)
    assert words in rejection(tmp_path)


@pytest.mark.parametrize(
    ("geometry", "words"),
    [
        ('<mesh filename="gone.obj"/>', "gone.obj is missing"),
        ('<mesh filename="thing.stl"/>', "is not an OBJ file"),
        ('<mesh filename="thing.obj" scale="1 1"/>', "'1 1' is not 3 numbers"),
        ('<box size="1 1 1"/>', "is not a mesh"),
    ],
)
def test_unusable_geometry_is_rejected_with_its_urdf(tmp_path, geometry, words):
    write_obj(tmp_path)
    write_urdf(tmp_path)
    path = tmp_path / "thing.urdf"
    path.write_text(path.read_text().replace('<mesh filename="thing.obj"/>', geometry))
    message = rejection(tmp_path)
    assert words in message
    assert "thing.urdf" in message


def test_faces_that_point_down_are_rejected(tmp_path):
    write_obj(tmp_path, faces=[FACES[0]])
    write_urdf(tmp_path)
    assert "cannot be seen from above: no face of" in rejection(tmp_path)
    write_urdf(tmp_path, mesh='filename="thing.obj" scale="-1 1 1"')
    assert look(tmp_path)[1].min() > 40, "the mirrored face points up"


@pytest.mark.parametrize(
    ("scale", "values", "words"),
    [
        ((1000, 1000, 1000), {}, "measures 60 x 40 x 40 m: is its model in millimetres? Set size: 0.08"),
        ((0.001, 0.001, 0.001), {}, "measures 6e-05 x 4e-05 x 4e-05 m: is its model in another unit"),
        ((1, 1, 8), {}, "reaches 32.0 cm above the table, the camera is at 30.0 cm (camera/distance)"),
        ((1, 1, 7.4), {}, "reaches 29.6 cm above the table"),
        ((1, 1, 1), {"height": 0.31}, "reaches 35.0 cm above the table"),
    ],
)
def test_unsuitable_size_is_rejected(tmp_path, scale, values, words):
    write_obj(tmp_path, scale=scale)
    write_urdf(tmp_path)
    assert words in rejection(tmp_path, **values)


def test_mesh_without_extent_is_rejected(tmp_path):
    write_obj(tmp_path, scale=(0, 0, 0))
    write_urdf(tmp_path)
    assert "has an extent of 0 m: check its vertices and scale" in rejection(tmp_path, size=0.08)
    write_obj(tmp_path, scale=(1e5, 1e5, 1e5))
    write_urdf(tmp_path, mesh='filename="thing.obj" scale="1e308 1e308 1e308"')
    assert "has an extent of nan m" in rejection(tmp_path, size=0.08)


def test_mesh_in_millimetres_is_used_with_size(tmp_path):
    write_obj(tmp_path, scale=(1000, 1000, 1000))
    write_urdf(tmp_path, f'<material name="red">{RGBA}</material>')
    assert_coloured(tmp_path, RED, size=0.06)


def test_named_pipe_as_material_file_is_rejected_unopened(tmp_path):
    write_obj(tmp_path, "mtllib thing.mtl", "g")
    write_urdf(tmp_path)
    os.mkfifo(tmp_path / "thing.mtl")  # opening it would wait for a writer for ever
    assert "it is a named pipe" in rejection(tmp_path)


def png_of_size(width, height):
    """Return a small PNG file with any size in its header."""
    _, data = cv2.imencode(".png", np.zeros((8, 8, 3), np.uint8))
    data = bytearray(data.tobytes())
    data[16:24] = width.to_bytes(4, "big") + height.to_bytes(4, "big")
    data[29:33] = zlib.crc32(data[12:29]).to_bytes(4, "big")
    return bytes(data)


@pytest.mark.parametrize("use", ["table", "object"])
def test_huge_picture_is_rejected_by_its_header(tmp_path, use):
    (tmp_path / "huge.png").write_bytes(png_of_size(32760, 32760))
    if use == "object":
        write_obj(tmp_path)
        write_urdf(tmp_path, '<material><texture filename="huge.png"/></material>')
        assert "huge.png has 32760 x 32760 pixels: reduce it" in rejection(tmp_path)
        return
    (tmp_path / "mine.yaml").write_text("table: {texture: huge.png}")
    with pytest.raises(WorldError, match=r"huge.png has 32760 x 32760 pixels: reduce it"):
        Scene(load_world(tmp_path / "mine.yaml", WORKSPACE), CameraConfig())


@pytest.mark.parametrize(
    "text", ['<!DOCTYPE a [<!ENTITY b "c">]><robot/>', "<robot>\0</robot>", "<robot", "", "<a>" * 9000]
)
def test_hostile_urdf_is_rejected(tmp_path, text):
    write_obj(tmp_path)
    (tmp_path / "thing.urdf").write_text(text)
    assert "thing.urdf" in rejection(tmp_path)


@pytest.fixture(scope="module")
def sample(tmp_path_factory):
    """A valid world of small files, as a folder, and their contents."""
    folder = tmp_path_factory.mktemp("sample")
    write_picture(folder / "green.png")
    (folder / "thing.mtl").write_text("newmtl g\nKd 1 1 1\nmap_Kd -s 1 1 1 green.png\n")
    write_obj(folder, "mtllib thing.mtl", "g")
    write_urdf(folder, '<origin xyz="0 0 0" rpy="0 0 0"/>')
    world(folder)
    return folder, {path.name: path.read_bytes() for path in folder.iterdir()}


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_mutated_files_are_rendered_or_rejected(sample, data):
    """Changed, removed and repeated bytes of each file lead to an image or a WorldError, never to anything else."""
    folder, contents = sample
    name = data.draw(st.sampled_from(sorted(contents)))
    content = bytearray(contents[name])
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, max(len(content) - 1, 0)))
        change = data.draw(st.sampled_from(["set", "cut", "repeat", "digit"]))
        if change == "set":
            content[at : at + 1] = data.draw(st.binary(min_size=1, max_size=3))
        elif change == "cut":
            del content[at : at + data.draw(st.integers(1, 40))]
        elif change == "repeat":
            content[at:at] = content[at : at + data.draw(st.integers(1, 40))] * data.draw(st.integers(1, 20))
        else:
            content[at : at + 1] = str(data.draw(st.integers(-(10**12), 10**12))).encode()
    (folder / name).write_bytes(content)
    try:
        with suppress(WorldError):
            scene = Scene(load_world(folder / "mine.yaml", WORKSPACE, CameraConfig()), CameraConfig())
            assert scene.render((0.475, 0.0, 0.0)).shape == (180, 180, 3)
            scene.close()
    finally:
        Path(folder / name).write_bytes(contents[name])
