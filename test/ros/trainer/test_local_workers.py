"""Warning about workers on the trainer's own computer."""

import pytest
import torch

from embodied_active_learning.ros.trainer.local_workers import local_workers_warning


@pytest.mark.parametrize(("device", "count", "warns"), [("cpu", 3, True), ("cuda", 3, False), ("cpu", 0, False)])
def test_local_workers_without_gpu_are_warned_about(device, count, warns):
    assert ("do not pay off" in local_workers_warning(torch.device(device), count)) == warns
