#!/usr/bin/env python3
"""Plug in an explorer and an information measure of your own, and learn a simulated world with them.

python3 examples/own_explorer.py
"""

import argparse

import numpy as np

import embodied_active_learning as eal
from embodied_active_learning.state_dict import matching_arrays


@eal.EXPLORERS.register("lawnmower")
class LawnmowerExplorer(eal.Explorer):
    """Visits a grid of poses row by row, whatever the target is."""

    def __init__(self, config: eal.Config, seed: int) -> None:
        axis = np.linspace(-0.9, 0.9, 10)
        grid = np.array([(x, y, theta) for theta in (-0.5, 0.5) for x in axis for y in axis])
        self._poses = config.workspace.box().denormalise(grid)
        self._next = 0

    def observe(self, position, measured_velocity=None):
        """Ignore the state: the grid is fixed."""

    def next_command(self, target, samples):
        """Go to the next pose of the grid."""
        pose = self._poses[self._next % len(self._poses)]
        self._next += 1
        return eal.PoseCommand.from_array(pose)

    def reset(self):
        """Nothing to discard: there is no plan."""

    def state_dict(self):
        return {"next": np.array([self._next])}

    def load_state_dict(self, state):
        self._next = int(matching_arrays(state, self.state_dict())["next"][0])

    @property
    def planned_states(self):
        return np.empty((0, 3))


@eal.INFORMATION_MEASURES.register("variance")
def variance(log_std, coverage):
    """Return a target distribution (S,) proportional to the predicted variance."""
    weights = np.exp(2.0 * (log_std - log_std.max()))
    return weights / weights.sum()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("steps", type=int, nargs="?", default=200)
    options = vars(parser.parse_args())
    print(eal.learn(eal.load_config("demo", explorer="lawnmower", measure="variance", **options)).paths.path)
