#!/usr/bin/env python3
"""Read a stored session with numpy: configuration, trajectory, images, tables and model.

python3 examples/read_a_session.py ~/.ros/embodied_active_learning/SESSION
"""

import argparse

import numpy as np

import embodied_active_learning as eal


def main(path: str) -> None:
    """Print what a session contains."""
    session = eal.load_session(path)
    config = session.config
    print(f"{session.name}: world {config.simulation.world}, explorer {config.exploration.explorer}")

    with session.open_observations() as store:
        states, images = store.raw_states, store.images  # (N, 3) [m, m, rad] and (N, H, W, 3) uint8 RGB
    print(f"{len(states)} images of {images.shape[2]} x {images.shape[1]} px")
    print(f"from x {np.ptp(states[:, 0]):.2f} m, y {np.ptp(states[:, 1]):.2f} m, yaw {np.ptp(states[:, 2]):.2f} rad")

    exploration, training = session.read_table("exploration"), session.read_table("training")
    if len(exploration["step"]):
        print(f"ergodic measure {exploration['ergodic_measure'][-1]:.3f} nat")
    if len(training["update"]):
        print(f"loss {training['loss'][0]:.3f} at the first, {training['loss'][-1]:.3f} at the last update")

    model = eal.load_model(session)
    if model is None:
        print("no model yet")
        return
    newest = store.snapshot()
    latents, stds = model.encode(newest.raw_states[-5:], newest.images[-5:])  # (5, L) each
    print(f"latents of the last image: {np.round(latents[-1], 2)}, mean std {stds[-1].mean():.3f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("session", help="folder of the session")
    main(parser.parse_args().session)
