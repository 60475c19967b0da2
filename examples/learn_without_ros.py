#!/usr/bin/env python3
"""Learn a simulated world and find its objects in another one, without ROS.

pip install . && python3 examples/learn_without_ros.py
"""

import argparse

import embodied_active_learning as eal


def main(steps: int, images: int, root: str) -> None:
    """Learn, fingerprint and identify."""
    config = eal.load_config("demo", world="right", steps=steps, root=root)
    session = eal.learn(config)
    fingerprints = eal.fingerprint(session)
    print(f"fingerprints: {', '.join(item.name for item in fingerprints.fingerprints)}")

    # Images of another table: an exploration that does not train.
    other_table = eal.load_config(
        "demo",
        world="star_plant_duck",
        explorer="uniform_ergodic",
        steps=images,
        updates_per_observation=0,
        root=root,
    )
    other = eal.learn(other_table)
    for decision in eal.identify(session, images_of=other):
        x, y, theta = decision.pose
        print(f"{decision.fingerprint}: {decision.reason}; best at x {x:.3f} m, y {y:.3f} m, yaw {theta:.2f} rad")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1000, help="exploration steps")
    parser.add_argument("--images", type=int, default=1000, help="images of the other table")
    parser.add_argument("--root", default="~/.ros/embodied_active_learning", help="folder of the sessions")
    options = parser.parse_args()
    main(options.steps, options.images, options.root)
