"""Reproduction of things on a painted table by a model that knows one of them."""

import numpy as np
import torch

from embodied_active_learning.config import Config
from embodied_active_learning.objects.reproduction import reproduced_share
from embodied_active_learning.objects.salience import Background
from painted_table import PaintedModel, Thing, paint, random_states

CONFIG = Config.from_dict({"camera": {"width": 45, "height": 45}})
KNOWN, OTHER = Thing(0, (0.40, -0.07, 0.5)), Thing(1, (0.55, 0.07, 0.0))


def test_share_of_known_and_unknown_things():
    states = random_states(CONFIG.workspace.box(), 120)
    images = paint(states, (KNOWN, OTHER), CONFIG.camera)
    weights = torch.tensor([[KNOWN.kind, *KNOWN.pose, KNOWN.radius]])
    model = PaintedModel(CONFIG, {"things": weights})

    def share(place):
        return reproduced_share(model, states, images, np.array(place), Background(images), CONFIG.camera)

    assert share(KNOWN.pose[:2]) > 0.8
    assert abs(share(OTHER.pose[:2])) < 0.1
    assert share((0.40, 0.12)) == 0.0  # bare table
