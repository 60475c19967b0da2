"""Random worlds, and the scripts for worlds."""

import itertools
import math
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.errors import WorldError
from embodied_active_learning.simulation.random_world import random_world, write_world
from embodied_active_learning.simulation.world import load_world
from embodied_active_learning.simulation.world_settings import GeneratedTexture
from embodied_active_learning.workspace import Workspace

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
WORKSPACE = Workspace()


def test_random_world_without_kinds_is_refused():
    with pytest.raises(WorldError, match="kinds is empty"):
        random_world(0, kinds=())


@pytest.mark.parametrize("seed", range(3))
def test_random_world_is_valid_and_spaced(tmp_path, seed):
    settings = random_world(seed, count=4, spacing=0.09, distractors=2, kinds=("duck", "star"), lighting=True)
    write_world(settings, tmp_path / "mine.yaml")
    world = load_world(tmp_path / "mine.yaml", WORKSPACE, CameraConfig())
    assert len(world.objects) == 6
    assert {item.kind for item in world.objects[:4]} <= {"duck", "star"}
    for item in world.objects[4:]:
        assert item.kind.startswith("random_")
        assert 0.06 <= item.extent.max() <= 0.09
    for first, second in itertools.combinations(world.objects, 2):
        assert math.dist(first.position, second.position) >= 0.09
    assert WORKSPACE.contains(np.array([(*item.position, 0.0) for item in world.objects])).all()
    assert world.lighting == settings.lighting
    assert world.table.generated == settings.table.generate


def test_random_world_follows_from_its_arguments():
    assert random_world(1) == random_world(1)
    assert random_world(1) != random_world(2)
    table = GeneratedTexture("wood", 3)
    assert random_world(1, table=table, kinds=("random_urdfs/000",)).table.generate == table


def test_impossible_random_world_is_rejected(tmp_path):
    with pytest.raises(WorldError, match=r"no room for 20 objects 0.1 m apart"):
        random_world(0, count=20)
    every = [f"random_urdfs/{number:03d}" for number in range(1000)]
    with pytest.raises(WorldError, match="0 of 1 procedural objects are left"):
        random_world(0, count=0, kinds=every, distractors=1)
    with pytest.raises(WorldError, match="unknown kind 'cat'"):
        random_world(0, kinds=("cat",))
    write_world(random_world(0), tmp_path / "mine.yaml")
    with pytest.raises(WorldError, match=r"cannot write .*mine.yaml: File exists"):
        write_world(random_world(0), tmp_path / "mine.yaml")


def script(name, *arguments):
    command = [sys.executable, str(SCRIPTS / name), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


def test_scripts_write_and_preview_a_world(tmp_path):
    written = script("random_world", tmp_path / "mine.yaml", "--seed", 3, "--distractors", 1)
    assert written.returncode == 0, written.stderr
    shown = script("show_world", tmp_path / "mine.yaml", "--output", tmp_path / "mine.png")
    assert shown.returncode == 0, shown.stderr
    assert "object_1: " in shown.stdout
    assert cv2.imread(str(tmp_path / "mine.png")).shape == (960, 960, 3)


def test_preview_reports_invalid_world(tmp_path):
    (tmp_path / "mine.yaml").write_text("objects: {a: {urdf: gone.urdf, position: [0.4, 0.0]}}")
    shown = script("show_world", tmp_path / "mine.yaml")
    assert shown.returncode == 2
    assert "gone.urdf is missing" in shown.stderr
