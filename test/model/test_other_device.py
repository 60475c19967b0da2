"""Training on a GPU, shown on a fake device that rejects the same operations as CUDA.

It has memory of its own and refuses CPU tensors, but computes on the CPU: this finds tensors on the wrong device, and
says nothing about a GPU's results or speed.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import other_device

TESTS = Path(__file__).resolve().parents[1]
CASES = ("support/other_device_cases.py", "model/test_learner.py", "pipeline/test_training.py")


@pytest.mark.skipif(shutil.which("g++") is None, reason="no g++")
def test_training_on_fake_device(tmp_path):
    library = other_device.build(TESTS.parent / "build")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), other_device.LIBRARY: str(library)}
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-p", "other_device", "--basetemp"]
    subprocess.run([*command, tmp_path / "cases", *(TESTS / cases for cases in CASES)], check=True, env=environment)
