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
LEARNER = (  # each operation of the learner on tensors of its device
    "test_update_reports_loss_and_terms",
    "test_decoder_starts_at_mean_colour_or_black",
    "test_non_finite_loss_is_skipped_and_counted",
    "test_resumed_training_is_bit_identical",
    "test_evaluation_compares_own_shuffled_and_no_latents",
    "test_replica_keeps_the_network_of_its_refresh",
    "test_conditional_log_std_uses_the_observations_latent",
    "test_replica_encodes_one_image_per_state_or_one_for_all",
    "test_vectors_restore_weights_and_moments",
    "test_average_is_weighted_by_updates",
)
CASES = (TESTS / "support/other_device_cases.py", *(f"{TESTS / 'model/test_learner.py'}::{name}" for name in LEARNER))


@pytest.mark.skipif(shutil.which("g++") is None, reason="no g++")
def test_training_on_fake_device(tmp_path):
    library = other_device.build(TESTS.parent / "build")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), other_device.LIBRARY: str(library)}
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-p", "other_device", "--basetemp"]
    subprocess.run([*command, tmp_path / "cases", *CASES], check=True, env=environment)
