"""Small valid fingerprints and fingerprint sets."""

import numpy as np
import torch

from embodied_active_learning.config import Config
from embodied_active_learning.objects.fingerprint import BLANK, OBJECT, Fingerprint, FingerprintSet
from embodied_active_learning.objects.limits import Calibration

CONFIG = Config.from_dict({"camera": {"width": 9, "height": 8}, "model": {"latent_size": 2}})


def make_fingerprint(views=3, **fields):
    values = {
        "name": "object-1",
        "kind": OBJECT,
        "centre": np.array([0.4, 0.1, 0.0]),
        "states": np.arange(3.0 * views).reshape(views, 3),
        "images": np.arange(views * 8 * 9 * 3).reshape(views, 8, 9, 3).astype(np.uint8),
        "latent_means": np.zeros((views, 2), np.float32),
        "latent_stds": np.ones((views, 2), np.float32),
        "importance": 0.25,
    }
    if fields.get("kind", OBJECT) == OBJECT:
        values["calibration"] = Calibration(np.linspace(0.3, 0.7, 5), np.linspace(-0.1, 0.5, 5))
    return Fingerprint(**{**values, **fields})


def make_set(**fields):
    values = {
        "session": "a",
        "updates": 9000,
        "observations": 3000,
        "created": "2026-11-22T12:45:00Z",
        "config": CONFIG,
        "weights": {"layer.weight": torch.ones(2, 3)},
        "fingerprints": (make_fingerprint(), make_fingerprint(name="blank-1", kind=BLANK, importance=0.0)),
    }
    return FingerprintSet(**{**values, **fields})
