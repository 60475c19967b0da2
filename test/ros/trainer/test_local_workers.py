"""Warning about workers on the trainer's own computer."""

import pytest

from embodied_active_learning.config import Config
from embodied_active_learning.ros.trainer import local_workers
from embodied_active_learning.ros.trainer.local_workers import local_workers_warning


@pytest.mark.parametrize(
    ("device", "has_gpu", "count", "warns"),
    [("auto", False, 3, True), ("cpu", True, 1, True), ("auto", True, 3, False), ("auto", False, 0, False)],
)
def test_local_workers_without_gpu_are_warned_about(monkeypatch, device, has_gpu, count, warns):
    monkeypatch.setattr(local_workers.torch.cuda, "is_available", lambda: has_gpu)
    config = Config.from_dict({"training": {"trainers": 4, "device": device}})
    assert ("do not pay off" in local_workers_warning(config, count)) == warns
