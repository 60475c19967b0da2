"""Trainer workers on the trainer's own computer."""

from __future__ import annotations

import torch

from embodied_active_learning.config import Config


def local_workers_warning(config: Config, count: int) -> str:
    """Return why `count` workers on this computer do not pay off; empty if they may: they need GPUs."""
    uses_gpu = config.training.device != "cpu" and torch.cuda.is_available()
    if count == 0 or uses_gpu:
        return ""
    return (
        "several trainers do not pay off on one computer without GPUs: use trainers:=1, or start the workers on other "
        "computers (docs/performance.md)"
    )
