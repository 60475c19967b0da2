#!/usr/bin/env python3
"""Time of one image of the simulated camera, on every shipped world, and of one move of the simulated arm by part.

    source setup.bash && OPENBLAS_NUM_THREADS=1 python3 benchmarks/benchmark_camera.py

An image is compared with the plain way to make it, taking turns in one process: table and objects as bodies of one
PyBullet scene, all of which TinyRenderer draws at full size for every image. Other work on the cores disturbs both
alike: trust the ratios before the milliseconds, and processor time before wall time.
"""

from __future__ import annotations

import argparse
import math
import time
from io import BytesIO
from typing import Callable, Dict, List, NamedTuple, TypeVar

import cv2
import numpy as np
import pybullet
import rospy
from rosgraph_msgs.msg import Clock

from embodied_active_learning.config import CameraConfig, Config
from embodied_active_learning.ros import conversions
from embodied_active_learning.simulation.scene import Scene
from embodied_active_learning.simulation.simulation import Simulation
from embodied_active_learning.simulation.world import Table, World, load_world, world_names

YAWS_OVER_OBJECTS = (-1.0, 0.5)  # rad, of the poses centred on each object
Result = TypeVar("Result")


class Turn(NamedTuple):
    """What one call took: wall time and processor time of this process [ms]."""

    wall: float
    cpu: float


class PlainScene(Scene):
    """The same world with its table as one more body, wholly drawn by TinyRenderer from PyBullet's own matrices."""

    def __init__(self, world: World, camera: CameraConfig) -> None:
        """Load everything, the table as a textured box."""
        super().__init__(world, camera)
        self._lay_table(world.table)

    def render(self, pose: np.ndarray, height: float = 0.3) -> np.ndarray:
        """Image (H, W, 3) uint8 from pose (x m, y m, theta rad), height m above the table."""
        x, y, theta = pose
        _, _, colours, _, _ = pybullet.getCameraImage(
            self._camera.width,
            self._camera.height,
            viewMatrix=pybullet.computeViewMatrix(
                (x, y, height), (x, y, 0.0), (-math.sin(theta), math.cos(theta), 0.0)
            ),
            projectionMatrix=pybullet.computeProjectionMatrixFOV(
                self._camera.field_of_view, self._camera.width / self._camera.height, 0.01, 2.0
            ),
            shadow=0,
            renderer=pybullet.ER_TINY_RENDERER,
            physicsClientId=self._client,
        )
        image = np.asarray(colours, dtype=np.uint8).reshape(self._camera.height, self._camera.width, 4)
        return np.ascontiguousarray(image[:, :, :3])

    def _lay_table(self, table: Table) -> None:
        width, depth = table.size
        shape = pybullet.createVisualShape(
            pybullet.GEOM_BOX,
            halfExtents=(width / 2.0, depth / 2.0, 1e-3),
            rgbaColor=(1.0, 1.0, 1.0, 1.0),
            physicsClientId=self._client,
        )
        body = pybullet.createMultiBody(0.0, -1, shape, (*table.centre, -1e-3), physicsClientId=self._client)
        texture = pybullet.loadTexture(str(table.texture), physicsClientId=self._client)
        pybullet.changeVisualShape(body, -1, textureUniqueId=texture, physicsClientId=self._client)


class Stopwatch:
    """Collects turns by name."""

    def __init__(self) -> None:
        self.turns: Dict[str, List[Turn]] = {}

    def timed(self, name: str, call: Callable[[], Result]) -> Result:
        """What the call returns."""
        wall, cpu = time.perf_counter(), time.process_time()
        result = call()
        turn = Turn(1e3 * (time.perf_counter() - wall), 1e3 * (time.process_time() - cpu))
        self.turns.setdefault(name, []).append(turn)
        return result

    def cells(self, name: str) -> str:
        """Median and 95th percentile of wall time, then of processor time [ms], as cells of a table."""
        wall, cpu = np.array(self.turns[name]).T
        times = (np.median(wall), np.percentile(wall, 95), np.median(cpu), np.percentile(cpu, 95))
        return " | ".join(f"{value:.2f}" for value in times)


def time_images(world: World, config: Config, count: int) -> Stopwatch:
    """Images from random poses of the workspace, and from poses centred on each object, made in both ways by turns."""
    box = config.workspace.box()
    anywhere = np.random.default_rng(0).uniform(box.lower, box.upper, (count, 3))
    over_objects = [(*item.position, yaw) for item in world.objects for yaw in YAWS_OVER_OBJECTS]
    watch = Stopwatch()
    plain, scene = PlainScene(world, config.camera), Scene(world, config.camera)
    for pose in np.array([*anywhere, *over_objects]):
        watch.timed("plain", lambda pose=pose: plain.render(pose))
        watch.timed("scene", lambda pose=pose: scene.render(pose))
    plain.close()
    scene.close()
    return watch


def report_images(config: Config, count: int) -> None:
    """Print a row for each world."""
    print("image [ms] | plain: wall | p95 | cpu | p95 | ours: wall | p95 | cpu | p95 | ratio of median cpu")
    for name in world_names():
        watch = time_images(load_world(name, config.workspace.box()), config, count)
        plain, ours = (np.median([turn.cpu for turn in watch.turns[way]]) for way in ("plain", "scene"))
        print(f"{name} | {watch.cells('plain')} | {watch.cells('scene')} | {plain / ours:.1f}")


def messages(simulation: Simulation, image: np.ndarray, camera: CameraConfig) -> None:
    """Make and serialise what the node of the simulated arm publishes after each move."""
    stamp = rospy.Time.from_sec(simulation.time)
    for message in (
        Clock(stamp),
        conversions.joint_state_message(stamp, simulation.joint_positions, simulation.joint_velocities),
        conversions.state_message(stamp, simulation.pose, simulation.velocity),
        conversions.camera_info_message(stamp, simulation.intrinsics(), camera.height, camera.width),
        conversions.image_message(stamp, image),
    ):
        message.serialize(BytesIO())


def report_moves(config: Config, count: int) -> None:
    """Print the time of each part of random moves, each as long as an exploration step."""
    speeds = np.array([config.arm.max_speed, config.arm.max_speed, config.arm.max_turn_rate])
    velocities = np.random.default_rng(0).uniform(-speeds, speeds, (count, 3))
    watch = Stopwatch()
    with Simulation(load_world(config.simulation.world, config.workspace.box()), config) as simulation:
        for velocity in velocities:
            watch.timed("servo and physics", lambda v=velocity: simulation.move(v, config.exploration.step_duration))
            image = watch.timed("image", simulation.image)
            watch.timed("messages", lambda image=image: messages(simulation, image, config.camera))
    print(f"\nmove of {config.exploration.step_duration} s [ms] | wall | p95 | cpu | p95")
    for part in watch.turns:
        print(f"{part} | {watch.cells(part)}")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=40, help="random poses on each world, beside those over objects")
    parser.add_argument("--moves", type=int, default=200, help="moves timed")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    report_images(Config(), arguments.images)
    report_moves(Config(), arguments.moves)


if __name__ == "__main__":
    main()
