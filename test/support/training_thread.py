"""Training runs on small random images, with a training thread as in the trainer node."""

import threading
from contextlib import contextmanager
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from embodied_active_learning.config import Config, merge
from embodied_active_learning.errors import DivergenceError

TIMEOUT = 60.0
STEPS = 20


def configured(root, changes=MappingProxyType({}), **session):
    """Return a configuration with changed sections, and of the section session."""
    values = {
        "camera": {"width": 45, "height": 45},
        "model": {"hidden_sizes": [64, 32]},
        "training": {"batch_size": 4, "first_update_at": 4, "updates_per_observation": 2, "evaluate_every": 10},
        "exploration": {"steps": STEPS, "samples": 50, "fresh_samples": 5},
        "session": {"name": "run", "root": str(root), **session},
    }
    return Config.from_dict(merge(values, changes))


class Training(NamedTuple):
    """Output of a training thread: reports, whether it has finished, and errors."""

    reports: list
    finished: threading.Event
    errors: list


def observation(index, side=45):
    """Return observation number index, always the same, with an image of side x side pixels."""
    random = np.random.default_rng(index)
    state = random.uniform([0.33, -0.14, -1.9], [0.62, 0.14, 1.9])
    return index, 0.2 * index, state, random.integers(0, 256, (side, side, 3), dtype=np.uint8)


def hand_over(run, indices):
    """Pass observations to a run."""
    for index in indices:
        run.observe(*observation(index, run.config.camera.width))


@contextmanager
def training(run):
    """Train a run in a thread and yield Training; stopped and closed when the block ends."""
    output = Training([], threading.Event(), [])

    def train():
        try:
            run.train(output.reports.append, output.finished.set)
        except Exception as error:
            output.errors.append(error)
            output.finished.set()
            if not isinstance(error, DivergenceError):
                raise

    thread = threading.Thread(target=train)
    thread.start()
    try:
        yield output
    finally:
        run.stop()
        thread.join(TIMEOUT)
        run.close()
        assert not thread.is_alive()
