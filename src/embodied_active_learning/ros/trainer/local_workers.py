"""Trainer workers on the trainer's own computer."""

from __future__ import annotations

import torch


def local_workers_warning(device: torch.device, count: int) -> str:
    """Return why `count` workers beside a trainer on a device do not pay off; empty if they may: they need GPUs."""
    if count == 0 or device.type != "cpu":
        return ""
    return (
        "several trainers do not pay off on one computer without GPUs: use trainers:=1, or start the workers on other "
        "computers (docs/performance.md)"
    )
