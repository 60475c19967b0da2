"""A model that lives on a GPU: what holds on the CPU holds there, shown with a device that only looks like another one.

It has its own memory, and refuses tensors of the CPU, but works on the CPU: this shows that nothing is mixed up and
nothing left behind, and tells nothing about a GPU's numbers or its speed.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import other_device

FOLDER = Path(__file__).resolve().parents[1] / "support"


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    path = tmp_path_factory.mktemp("device") / "other_device.so"
    other_device.build(path)
    return path


@pytest.mark.skipif(shutil.which("g++") is None, reason="no g++")
@pytest.mark.parametrize("cases", ["other_device_cases.py", "test_model_learner.py", "test_training_run.py"])
def test_learning_holds_on_another_device(library, tmp_path, cases):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), other_device.LIBRARY: str(library)}
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-p", "other_device", "--basetemp"]
    subprocess.run([*command, str(tmp_path / "cases"), str(FOLDER / cases)], check=True, env=environment)
