"""Figures of a learning session, and their independence of the user's Matplotlib settings."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch

from embodied_active_learning.config import Config
from embodied_active_learning.errors import SessionError
from embodied_active_learning.figures.entropy_map import entropy_maps
from embodied_active_learning.figures.learning_metrics import _columns, draw_learning_metrics
from embodied_active_learning.figures.reconstructions import select_images
from embodied_active_learning.figures.session_figures import draw_session_figures
from embodied_active_learning.figures.top_view import compose_top_view, load_session_images
from embodied_active_learning.geometry import metres_per_pixel
from embodied_active_learning.model.cvae import ConditionalVAE
from embodied_active_learning.objects.scoring import TrueObject
from embodied_active_learning.session.checkpoints import save_model
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.tables import COLUMNS
from embodied_active_learning.workspace import Workspace
from painted_table import KINDS, Thing, paint

DISCS = (Thing(0, (0.39, -0.10, 0.0)), Thing(1, (0.55, 0.08, 0.0), radius=0.025))


def photograph(state, camera):
    """Return the image (H, W, 3) of the discs from a camera at (x, y, yaw)."""
    return paint([state], DISCS, camera, noise=0.0)[0]


def make_config(root, name="a", **sections):
    values = {
        "session": {"root": str(root), "name": name},
        "camera": {"width": 45, "height": 45},
        "model": {"latent_size": 4, "hidden_sizes": [32, 16]},
        "training": {"first_update_at": 2, "batch_size": 2},
        "exploration": {"steps": 60},
    }
    return Config.from_dict({**values, **sections})


def make_session(root, name="a", count=60, **sections):
    """Return a finished session with synthetic numbers."""
    config = make_config(root, name, **sections)
    random = np.random.default_rng(config.exploration.seed)
    states = config.workspace.box().denormalise(random.uniform(-1.0, 1.0, (count, 3)))
    with contextlib.ExitStack() as opened:
        session = opened.enter_context(Session.open_for_writing(config))
        store = opened.enter_context(session.open_observations())
        exploration, training = (opened.enter_context(session.open_table(name)) for name in ("exploration", "training"))
        for index, state in enumerate(states):
            store.append(index, 0.2 * index, state, photograph(state, config.camera))
            exploration.append({"step": index, "ergodic_measure": 3.0 / (1 + index)})
            row = {"update": index + 1, "loss": -0.01 * index, "beta": 1e-4, "gamma": 0.05, "active_units": 3}
            training.append(row)
    return Session.open_read_only(root / name)


def make_network(config):
    torch.manual_seed(0)
    return ConditionalVAE((config.camera.height, config.camera.width), 3, config.model)


def assert_picture(path):
    picture = cv2.imread(str(path))
    assert picture.std() > 10.0


def middle_of(view, disc):
    """Return the mean position (x, y) [m] of the pixels of a disc's colours."""
    distance = np.min([np.abs(view.pixels - np.array(colour)).sum(axis=2) for colour in KINDS[disc.kind]], axis=0)
    rows, columns = np.nonzero((distance < 100) & view.seen)
    left, right, bottom, top = view.extent
    x = left + (columns.mean() + 0.5) / view.pixels.shape[1] * (right - left)
    return x, top - (rows.mean() + 0.5) / view.pixels.shape[0] * (top - bottom)


@pytest.mark.parametrize(("width", "height"), [(45, 45), (60, 40)])
def test_top_view_places_objects_within_2_mm(tmp_path, width, height):
    config = make_config(tmp_path, camera={"width": width, "height": height, "field_of_view": 35.0, "distance": 0.25})
    workspace = config.workspace.box()
    states = workspace.denormalise(np.random.default_rng(0).uniform(-1, 1, (150, 3)))
    images = np.stack([photograph(state, config.camera) for state in states])
    view = compose_top_view(images, states, config.camera, workspace)
    for disc in DISCS:
        assert middle_of(view, disc) == pytest.approx(disc.pose[:2], abs=0.002)


def test_top_view_marks_unseen_pixels(tmp_path):
    config = make_config(tmp_path)
    state = np.array([0.39, -0.10, 0.0])
    view = compose_top_view(photograph(state, config.camera)[None], state[None], config.camera, config.workspace.box())
    side = 45 * metres_per_pixel(config.camera)
    left, right, bottom, top = view.extent
    assert view.seen.mean() == pytest.approx(side**2 / ((right - left) * (top - bottom)), rel=0.1)
    assert middle_of(view, DISCS[0]) == pytest.approx((0.39, -0.10), abs=0.002)


def test_top_view_of_no_images_is_empty(tmp_path):
    config = make_config(tmp_path)
    images, states = np.empty((0, 45, 45, 3), np.uint8), np.empty((0, 3))
    assert not compose_top_view(images, states, config.camera, config.workspace.box()).seen.any()


def test_top_view_ignores_images_outside(tmp_path):
    config = make_config(tmp_path)
    state = np.array([0.39, -0.10, 0.3])
    inside = photograph(state, config.camera)
    images, states = np.stack([inside] * 5), np.tile(state, (5, 1))
    states[1:, :2] += [(3, 0), (-3, 0), (0, 3), (0, -3)]
    alone, among_others = (
        compose_top_view(images[:count], states[:count], config.camera, config.workspace.box()) for count in (1, 5)
    )
    assert np.array_equal(alone.pixels, among_others.pixels)
    assert np.array_equal(alone.seen, among_others.seen)


def test_pixel_size_at_30_degrees_and_30_cm():
    # 2 * 0.3 m * tan(15 degrees) = 160.8 mm over 180 pixels.
    assert metres_per_pixel(Config().camera) == pytest.approx(0.1608 / 180, rel=1e-3)


def test_session_figures_of_finished_run(tmp_path):
    session = make_session(tmp_path)
    save_model(session.paths.model, make_network(session.config).state_dict(), {"updates": 60, "observations": 40})
    objects = [TrueObject("red", "disc", 0.39, -0.10), TrueObject("blue", "disc", 0.55, 0.08)]
    paths = draw_session_figures(session, objects)
    assert [path.name for path in paths] == ["learning_metrics.png", "entropy.png", "reconstructions.png"]
    for path in paths:
        assert path.parent == session.paths.figures
        assert_picture(path)
    assert sorted(path.name for path in session.paths.figures.iterdir()) == sorted(path.name for path in paths)


def test_stopping_criterion_has_a_figure(tmp_path):
    session = make_session(tmp_path, count=2, exploration={"stop": "stable"})
    with session.paths.table("stopping").open("x") as stream:
        stream.write(
            f"{','.join(COLUMNS['stopping'])}\n150,113,0,2,nan,1,1.6,0.0,0.5,0\n300,163,2,0,,1,3.0,0.6,0.6,1\n"
        )
    figures = draw_session_figures(session)
    assert [path.name for path in figures] == ["learning_metrics.png", "stopping.png"]
    assert_picture(figures[1])


def test_figures_are_written_as_pdf_on_request(tmp_path):
    session = make_session(tmp_path, count=2, session={"root": str(tmp_path), "name": "a", "pdf_figures": True})
    (figure,) = draw_session_figures(session)
    assert figure.with_suffix(".pdf").read_bytes().startswith(b"%PDF")


def test_session_figures_without_model(tmp_path):
    session = make_session(tmp_path, count=2)
    assert [path.name for path in draw_session_figures(session)] == ["learning_metrics.png"]


def load_path(session):
    """Return a session's camera states and top view."""
    images = load_session_images(session)
    return images.observations.raw_states, images.table


def test_learning_metrics_group_seeds_by_world(tmp_path):
    """One column for each world and explorer; baselines come last."""
    runs = [
        SimpleNamespace(config=make_config(tmp_path, exploration={"seed": seed, "explorer": explorer}))
        for explorer in ("random_walk", "ergodic")
        for seed in (0, 1)
    ]
    assert _columns(runs) == {"diagonal": runs[2:], "diagonal, random walk": runs[:2]}


def test_learning_metrics_of_one_session_name_it(tmp_path):
    sections = {"exploration": {"seed": 7}, "simulation": {"world": "/lab/My_table.yaml"}}
    config = make_config(tmp_path, "first-run", **sections)
    assert list(_columns([SimpleNamespace(config=config)])) == ["first-run\nMy_table, seed 7"]


def test_learning_metrics_of_new_run(tmp_path, recwarn):
    session = make_session(tmp_path, count=1)
    for name in ("training", "exploration"):
        session.paths.table(name).unlink()
    assert_picture(draw_learning_metrics(tmp_path / "metrics.png", [session], load_path))
    assert [str(warning.message) for warning in recwarn] == []


def test_learning_metrics_need_a_session(tmp_path):
    with pytest.raises(SessionError, match="give at least one session"):
        draw_learning_metrics(tmp_path / "metrics.png", [], load_path)


def test_entropy_map_axes():
    class Slope:
        """A model whose log std is x + 10 y + 100 yaw + latent."""

        def log_std(self, latents, states):
            return latents + states @ [1.0, 10.0, 100.0]

    maps = entropy_maps(Slope(), np.array([[1.0], [3.0]]), Workspace((0.0, -1.0, -2.0), (2.0, 1.0, 2.0)))
    yaws, rows, columns = maps.shape
    assert maps.mean() == pytest.approx(1.0 + 2.0)
    np.testing.assert_allclose(np.diff(maps, axis=2), 2.0 / columns)
    np.testing.assert_allclose(np.diff(maps, axis=1), 20.0 / rows)
    np.testing.assert_allclose(np.diff(maps, axis=0), 400.0 / yaws)


@pytest.mark.parametrize("edge", [0.2, 0.4, 0.7])
def test_selected_images_show_every_object_and_table(edge):
    random = np.random.default_rng(0)
    states, images = random.uniform(-1, 1, (120, 3)), np.full((120, 12, 12, 3), 190, np.uint8)
    images += random.integers(0, 3, (120, 1, 1, 1), dtype=np.uint8)
    kinds = np.select([states[:, 0] < -edge, states[:, 0] > edge + 0.1], ["duck", "plant"], "table")
    for kind, colour in (("duck", (210, 200, 90)), ("plant", (20, 60, 20))):
        for index in np.flatnonzero(kinds == kind):  # at slightly different positions
            row, column = random.integers(0, 6, 2)
            images[index, row : row + 6, column : column + 6] = colour
    chosen = select_images(images, states, 8)
    assert len(chosen) == 8
    assert sorted(kinds[chosen]).count("table") == 1
    assert {"duck", "plant"} < set(kinds[chosen])
    assert np.all(np.diff(chosen) > 0)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_selected_images_are_unique(count):
    for images in (np.zeros((count, 12, 12, 3), np.uint8), np.eye(count, 432, dtype=np.uint8).reshape(-1, 12, 12, 3)):
        chosen = select_images(images, np.zeros((count, 3)), 8)
        assert set(chosen) <= set(range(count))
        assert 1 <= len(chosen) == len(set(chosen))


def run_python(program, **variables):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), **variables}
    subprocess.run([sys.executable, "-c", program], check=True, env=environment)


def test_figures_ignore_user_matplotlib_settings(tmp_path):
    """The user's matplotlibrc asks for LaTeX, which is not installed, and MPLBACKEND does not exist."""
    (tmp_path / "matplotlibrc").write_text("text.usetex: True\n")
    program = (
        "from embodied_active_learning.figures.style import default_style, label, new_figure, save\n"
        "def draw(path):\n"
        "    figure = new_figure(2, 2)\n"
        "    label(figure.subplots(), 'x [m]')\n"
        "    save(figure, path)\n"
        f"default_style(draw)({str(tmp_path / 'figure.png')!r})\n"
        "import matplotlib, os\n"
        "assert matplotlib.rcParams['text.usetex'] and os.environ['MPLBACKEND'] == 'missing'\n"
    )
    run_python(program, MPLCONFIGDIR=str(tmp_path), MPLBACKEND="missing", PATH="")
    assert cv2.imread(str(tmp_path / "figure.png")) is not None
