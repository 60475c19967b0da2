"""A valid decision."""

import numpy as np

from embodied_active_learning.objects.decision import FOUND, NOT_HERE, Decision
from embodied_active_learning.objects.fingerprint import OBJECT


def make_decision(**fields):
    """Return a decision that found object-1 of session a, with changed fields; instance 0 is one that did not."""
    values = {
        "session": "a",
        "fingerprint": "object-1",
        "kind": OBJECT,
        "outcome": FOUND if fields.get("instance", 1) > 0 else NOT_HERE,
        "instance": 1,
        "pose": (0.5, 0.1, 0.5),
        "confidence": 0.9,
        "error_rate": 0.05,
        "residual": 0.1,
        "views": 30,
        "belief_mean": 0.5,
        "belief_std": 0.1,
        "reason": "",
        **fields,
    }
    return Decision(**{**values, "pose": np.array(values["pose"])})
