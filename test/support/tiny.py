"""Settings of a run that takes about a second without ROS: small images, a small model and few steps."""

from __future__ import annotations

from typing import Any, Dict

STEPS = 24
TINY: Dict[str, Dict[str, Any]] = {
    "camera": {"width": 24, "height": 24},
    "model": {"latent_size": 2, "hidden_sizes": [8], "channels": [2], "kernels": [3], "strides": [3]},
    "training": {"batch_size": 8, "first_update_at": 8, "evaluate_every": 8, "evaluation_size": 8, "device": "cpu"},
    "exploration": {"steps": STEPS, "samples": 50, "fresh_samples": 5},
    "fingerprint": {"min_contrast": 1.0, "views": 3, "samples": 60, "min_share": 0.0, "view_box": 0.1, "trials": 3},
    "identification": {"cells": [4, 4, 4]},
}
