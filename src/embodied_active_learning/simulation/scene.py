"""What the wrist camera sees: the world's objects on their table, rendered without the arm."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Tuple

import cv2
import numpy as np
import pybullet

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.errors import WorldError
from embodied_active_learning.geometry import intrinsics, optical_rotation
from embodied_active_learning.simulation.table_picture import TablePicture
from embodied_active_learning.simulation.world import PlacedObject, World

_NEAR = 0.01  # m
_LIGHT = {
    "lightDirection": [0.4, 0.5, 1.0],
    "lightColor": [1.0, 1.0, 1.0],
    "lightDistance": 2.0,
    "lightAmbientCoeff": 0.6,
    "lightDiffuseCoeff": 0.55,
    "lightSpecularCoeff": 0.05,
    "shadow": 0,
}


@dataclass(frozen=True)
class SceneObject:
    """An object as it truly stands: centre of its mesh (x, y) in m, yaw in rad, size of its unturned box in m."""

    name: str
    kind: str
    centre: Tuple[float, float]
    yaw: float
    extent: Tuple[float, float, float]


class Scene:
    """Renders a world from planar camera poses, in a PyBullet client of its own."""

    def __init__(self, world: World, camera: CameraConfig) -> None:
        """Load every mesh and texture. Raises WorldError when PyBullet cannot."""
        self._camera = camera
        self._table = TablePicture(world.table)
        self._placed = world.objects
        self._boxes = np.array([_box(item) for item in world.objects]).reshape(-1, 8, 3)
        self._shown = [True] * len(world.objects)
        self._client = pybullet.connect(pybullet.DIRECT)
        try:
            self._bodies = [self._place(item) for item in world.objects]
        except WorldError:
            self.close()
            raise

    def close(self) -> None:
        """Free the client; the scene is of no use afterwards."""
        pybullet.disconnect(physicsClientId=self._client)

    @property
    def objects(self) -> Tuple[SceneObject, ...]:
        """The truth about every object."""
        return tuple(
            SceneObject(item.name, item.kind, tuple(item.position), item.yaw, tuple(map(float, item.extent)))
            for item in self._placed
        )

    def intrinsics(self) -> np.ndarray:
        """(3, 3) camera matrix K in pixels, pixel centres at whole numbers as in ROS."""
        return intrinsics(self._camera.width, self._camera.height, self._camera.field_of_view)

    def render(self, pose: np.ndarray, height: float = 0.3) -> np.ndarray:
        """Image (H, W, 3) uint8 RGB from pose (x m, y m, theta rad), height m above the table, looking straight down.

        Image right is the optical x axis, image down its y axis; the optical frame is Rz(theta) Rx(pi).
        """
        return self._picture(pose, height, self._camera.width, self._camera.height, self._camera.field_of_view)

    def top_view(self, centre: np.ndarray, size: float, width: int = 600) -> np.ndarray:
        """Image (width, width, 3) uint8 RGB of a square of the table: centre (2,) m, size m; right is +x, up is +y."""
        height = 2.0
        field_of_view = math.degrees(2.0 * math.atan(size / (2.0 * height)))
        return self._picture((centre[0], centre[1], 0.0), height, width, width, field_of_view)

    def _picture(self, pose: np.ndarray, height: float, columns: int, rows: int, field_of_view: float) -> np.ndarray:
        matrix = intrinsics(columns, rows, field_of_view)
        camera = np.eye(4)
        camera[:3, :3] = optical_rotation(pose[2])
        camera[:3, 3] = (pose[0], pose[1], height)
        picture = self._table.picture(camera, matrix, columns, rows)
        in_view = _in_view(self._boxes, camera, matrix, columns, rows)
        if any(in_view):
            self._show(in_view)
            self._draw_objects(picture, camera, matrix)
        return picture

    def _draw_objects(self, picture: np.ndarray, camera: np.ndarray, matrix: np.ndarray) -> None:
        """Draw the shown objects over the table's picture (rows, columns, 3) uint8 from pose (4, 4) with K (3, 3)."""
        rows, columns, _ = picture.shape
        _, _, colours, _, bodies = pybullet.getCameraImage(
            columns,
            rows,
            viewMatrix=_view_matrix(camera),
            projectionMatrix=_projection_matrix(matrix, columns, rows, 2.0 * camera[2, 3] + 1.0),
            renderer=pybullet.ER_TINY_RENDERER,
            physicsClientId=self._client,
            **_LIGHT,
        )
        objects = np.asarray(colours, dtype=np.uint8).reshape(rows, columns, 4)
        covered = (np.asarray(bodies).reshape(rows, columns) >= 0).astype(np.uint8)
        cv2.copyTo(cv2.cvtColor(objects, cv2.COLOR_RGBA2RGB), covered, picture)

    def _show(self, in_view: List[bool]) -> None:
        """Hide from the renderer the objects that are not in view: it would go through all of their triangles."""
        for item, body, visible, shown in zip(self._placed, self._bodies, in_view, self._shown):
            if visible != shown:
                # What has no opacity at all is skipped, rather than drawn as transparent.
                colour = (*_rgb(item), float(visible))
                pybullet.changeVisualShape(body, -1, rgbaColor=colour, physicsClientId=self._client)
        self._shown = in_view

    def _place(self, item: PlacedObject) -> int:
        """The number of the body that stands for an object."""
        model, turn = item.model, pybullet.getQuaternionFromEuler((0.0, 0.0, item.yaw))
        try:
            shape = pybullet.createVisualShape(
                pybullet.GEOM_MESH,
                fileName=str(model.mesh),
                meshScale=[item.scale * value for value in model.mesh_scale],
                visualFramePosition=[item.scale * value for value in model.mesh_position],
                visualFrameOrientation=pybullet.getQuaternionFromEuler(model.mesh_rpy),
                rgbaColor=(*_rgb(item), 1.0),
                physicsClientId=self._client,
            )
            origin = _origin(item)
            return pybullet.createMultiBody(0.0, -1, shape, origin, turn, physicsClientId=self._client)
        except pybullet.error as error:
            raise WorldError(f"object {item.name}: PyBullet cannot load {model.mesh}: {error}") from error


def _view_matrix(camera: np.ndarray) -> Tuple[float, ...]:
    """OpenGL view matrix, column by column, of an optical frame (4, 4): OpenGL looks along -z with y up."""
    view = np.diag([1.0, -1.0, -1.0, 1.0]) @ np.linalg.inv(camera)
    return tuple(view.T.ravel())


def _projection_matrix(matrix: np.ndarray, columns: int, rows: int, far: float) -> Tuple[float, ...]:
    """OpenGL projection, column by column, that puts what K (3, 3) puts at a pixel's centre into that pixel."""
    projection = np.zeros((4, 4))
    projection[0, 0] = 2.0 * matrix[0, 0] / columns
    projection[1, 1] = 2.0 * matrix[1, 1] / rows
    projection[2, 2] = -(far + _NEAR) / (far - _NEAR)
    projection[2, 3] = -2.0 * far * _NEAR / (far - _NEAR)
    projection[3, 2] = -1.0
    # TinyRenderer samples a pixel at its lower left corner: half a pixel from its centre.
    projection[0, 2], projection[1, 2] = 1.0 / columns, 1.0 / rows
    return tuple(projection.T.ravel())


def _box(item: PlacedObject) -> np.ndarray:
    """(8, 3) corners of the box around an object, m, in the base frame."""
    heights = (item.height, item.height + item.extent[2])
    return np.array([(x, y, z) for x, y in item.corners() for z in heights])


def _in_view(boxes: np.ndarray, camera: np.ndarray, matrix: np.ndarray, columns: int, rows: int) -> List[bool]:
    """Whether each of boxes (N, 8, 3), m, may reach into the picture from camera pose (4, 4) with K (3, 3).

    One whose corners all lie beyond the same edge of the picture cannot.
    """
    u, v, depth = np.moveaxis((boxes - camera[:3, 3]) @ camera[:3, :3] @ matrix.T, -1, 0)  # u and v times depth
    # A pixel more than the picture has on each side, for the renderer calculates in single precision.
    beyond = np.stack([u < -1.5 * depth, u > (columns + 0.5) * depth, v < -1.5 * depth, v > (rows + 0.5) * depth])
    return (~beyond.all(axis=-1).any(axis=0)).tolist()


def _origin(item: PlacedObject) -> np.ndarray:
    """(3,) where the model's origin goes so that its mesh is centred on the position and stands at the height."""
    cosine, sine = math.cos(item.yaw), math.sin(item.yaw)
    x, y, _ = item.scale * item.model.centre
    bottom = item.scale * item.model.lower[2]
    turned = (cosine * x - sine * y, sine * x + cosine * y)
    return np.array([item.position[0] - turned[0], item.position[1] - turned[1], item.height - bottom])


def _rgb(item: PlacedObject) -> Tuple[float, ...]:
    colour = item.model.colour if item.colour is None else item.colour
    return colour[:3]
