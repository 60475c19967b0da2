#!/usr/bin/env python3
"""Time per image of the simulated camera in every shipped world, and per part of a move of the simulated arm.

    source setup.bash && OPENBLAS_NUM_THREADS=1 python3 benchmarks/benchmark_camera.py

Reference: table and objects are bodies of one PyBullet scene, all drawn by TinyRenderer for every image. Both variants
alternate in one process, so that other load affects both: ratios are more reliable than milliseconds, and processor
time than wall time.
"""

from __future__ import annotations

import argparse
import math
from functools import partial
from io import BytesIO
from typing import Dict, List, Sequence

import cv2
import numpy as np
import pybullet
import rospy
from measuring import Row, Section, Turn, row, run, timed
from rosgraph_msgs.msg import Clock

from embodied_active_learning.config import CameraConfig, Config
from embodied_active_learning.ros import conversions
from embodied_active_learning.simulation.placed_objects import Table
from embodied_active_learning.simulation.scene import Scene
from embodied_active_learning.simulation.simulation import Simulation
from embodied_active_learning.simulation.world import World, load_world, world_names

YAWS_OVER_OBJECTS = (-1.0, 0.5)  # rad, of the poses centred on each object


class PlainScene(Scene):
    """The same world with the table as a body, drawn by TinyRenderer with PyBullet's matrices."""

    def __init__(self, world: World, camera: CameraConfig) -> None:
        """Load all objects, and the table as a textured box."""
        super().__init__(world, camera)
        self._lay_table(world.table)

    def render(self, pose: np.ndarray, height: float = 0.3, velocity: Sequence[float] = (0.0, 0.0, 0.0)) -> np.ndarray:
        """Return an image (H, W, 3) uint8 from pose (x m, y m, theta rad), height m above the table; without blur."""
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


def image_section(config: Config, count: int) -> Section:
    """Measure images from random poses in the workspace, and from poses centred on each object, with both variants."""
    rows: List[Row] = []
    for name in world_names():
        world, box = load_world(name, config.workspace.box()), config.workspace.box()
        anywhere = np.random.default_rng(0).uniform(box.lower, box.upper, (count, 3))
        over_objects = [(*item.position, yaw) for item in world.objects for yaw in YAWS_OVER_OBJECTS]
        turns: Dict[str, List[Turn]] = {"plain": [], "scene": []}
        plain, scene = PlainScene(world, config.camera), Scene(world, config.camera)
        for pose in np.array([*anywhere, *over_objects]):
            turns["plain"].append(timed(partial(plain.render, pose)))
            turns["scene"].append(timed(partial(scene.render, pose)))
        plain.close()
        scene.close()
        rows.append(row(f"{name}, table and objects drawn by TinyRenderer", turns["plain"]))
        rows.append(row(f"{name}, as shipped", turns["scene"], turns["plain"], "8 ms"))
    return Section(
        "One camera image", "180 x 180, one thread; random poses in the workspace, and over each object.", rows
    )


def messages(simulation: Simulation, image: np.ndarray, camera: CameraConfig) -> None:
    """Create and serialise the messages that the node of the simulated arm publishes after each move."""
    stamp = rospy.Time.from_sec(simulation.time)
    for message in (
        Clock(stamp),
        conversions.joint_state_message(stamp, simulation.joint_positions, simulation.joint_velocities),
        conversions.state_message(stamp, simulation.pose, simulation.velocity),
        conversions.camera_info_message(stamp, simulation.intrinsics(), camera.height, camera.width),
        conversions.image_message(stamp, image),
    ):
        message.serialize(BytesIO())


def move_section(config: Config, count: int) -> Section:
    """Measure the parts of random moves with the duration of an exploration step."""
    speeds = np.array([config.arm.max_speed, config.arm.max_speed, config.arm.max_turn_rate])
    velocities = np.random.default_rng(0).uniform(-speeds, speeds, (count, 3))
    turns: Dict[str, List[Turn]] = {"servo and physics": [], "image": [], "messages": []}
    images: List[np.ndarray] = []
    with Simulation(load_world(config.simulation.world, config.workspace.box()), config) as simulation:
        for velocity in velocities:
            move = partial(simulation.move, velocity, config.exploration.step_duration)
            turns["servo and physics"].append(timed(move))
            turns["image"].append(timed(lambda: images.append(simulation.image())))
            turns["messages"].append(timed(lambda: messages(simulation, images.pop(), config.camera)))
    rows = [row(part, taken) for part, taken in turns.items()]
    return Section("One move of the simulated arm", f"{config.exploration.step_duration} s of simulated time.", rows)


def measure(arguments: argparse.Namespace) -> List[Section]:
    """Return both sections."""
    cv2.setNumThreads(1)
    return [image_section(Config(), arguments.images), move_section(Config(), arguments.moves)]


if __name__ == "__main__":
    run(__doc__, measure, images=40, moves=200)
