"""Warning about workers on the trainer's own computer."""

import runpy

import pytest
import rospy
import torch

from launching import ROOT


@pytest.mark.parametrize(("device", "count", "warns"), [("cpu", 3, True), ("cuda", 3, False), ("cpu", 0, False)])
def test_local_workers_without_gpu_are_warned_about(monkeypatch, device, count, warns):
    warnings = []
    monkeypatch.setattr(rospy, "logwarn", warnings.append)
    node = runpy.run_path(str(ROOT / "nodes" / "trainer"))
    node["warn_of_local_workers"](torch.device(device), count)
    assert ["do not pay off" in line for line in warnings] == [True] * warns
