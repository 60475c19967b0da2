"""Render a world for the wrist camera: objects on their table, without the arm."""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, List, Sequence, Tuple, Union

import cv2
import numpy as np
import pybullet

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.errors import WorldError
from embodied_active_learning.geometry import intrinsics, optical_rotation
from embodied_active_learning.simulation.lighting import BLUR_SAMPLES, LightField
from embodied_active_learning.simulation.placed_objects import PlacedObject
from embodied_active_learning.simulation.placement import check_heights
from embodied_active_learning.simulation.table_picture import TablePicture
from embodied_active_learning.simulation.visual_mesh import write_visual
from embodied_active_learning.simulation.world import World

_NEAR = 0.01  # m
Pose = Union[Sequence[float], np.ndarray]
_SHADING = {
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
    """True pose of an object: centre of its mesh (x, y) in m, yaw in rad, size of its box at yaw 0 in m."""

    name: str
    kind: str
    centre: Tuple[float, ...]
    yaw: float
    extent: Tuple[float, ...]


class Scene:
    """Renders a world from planar camera poses, in its own PyBullet client."""

    def __init__(self, world: World, camera: CameraConfig) -> None:
        """Load all meshes and textures. Raises WorldError for an unusable one, or an object as high as the camera."""
        check_heights(world.objects, camera)
        self._camera = camera
        self._exposure = world.lighting.motion_blur
        self._light = LightField(world.lighting, world.table.centre)
        self._table = TablePicture(world.table)
        self._placed = world.objects
        self._boxes = np.array([_box(item) for item in world.objects]).reshape(-1, 8, 3)
        self._shown = [True] * len(world.objects)
        self._client = pybullet.connect(pybullet.DIRECT)
        try:
            self._bodies = self._load(world.objects)
        except WorldError:
            self.close()
            raise

    def close(self) -> None:
        """Free the client; nothing can be rendered afterwards."""
        pybullet.disconnect(physicsClientId=self._client)

    @property
    def objects(self) -> Tuple[SceneObject, ...]:
        """True poses of all objects."""
        return tuple(
            SceneObject(item.name, item.kind, tuple(item.position), item.yaw, tuple(map(float, item.extent)))
            for item in self._placed
        )

    def intrinsics(self) -> np.ndarray:
        """Return the camera matrix K (3, 3) in pixels, with pixel centres at whole numbers as in ROS."""
        return intrinsics(self._camera.width, self._camera.height, self._camera.field_of_view)

    def render(self, pose: np.ndarray, height: float = 0.3, velocity: Sequence[float] = (0.0, 0.0, 0.0)) -> np.ndarray:
        """Return the camera's image (H, W, 3) uint8 RGB.

        Image right is the optical x axis, image down its y axis; the optical frame is Rz(theta) Rx(pi).

        Args:
            pose: Camera (x m, y m, theta rad), looking straight down.
            height: Height of the camera above the table, m.
            velocity: Velocity of the camera (m/s, m/s, rad/s), for motion blur.
        """
        blur = self._exposure * np.asarray(velocity)
        if not blur.any():
            return self._render(pose, height)
        offsets = np.linspace(-0.5, 0.5, BLUR_SAMPLES)
        images = [self._render(np.asarray(pose) + offset * blur, height) for offset in offsets]
        return np.rint(np.mean(images, axis=0)).astype(np.uint8)

    def top_view(self, centre: np.ndarray, size: float, width: int = 600) -> np.ndarray:
        """Image (width, width, 3) uint8 RGB of a square of the table: centre (2,) m, size m; right is +x, up is +y."""
        height = 2.0
        field_of_view = math.degrees(2.0 * math.atan(size / (2.0 * height)))
        return self._picture((centre[0], centre[1], 0.0), height, width, width, field_of_view)

    def _render(self, pose: Pose, height: float) -> np.ndarray:
        return self._picture(pose, height, self._camera.width, self._camera.height, self._camera.field_of_view)

    def _picture(self, pose: Pose, height: float, columns: int, rows: int, view: float) -> np.ndarray:
        """Render with a field of view in degrees."""
        matrix = intrinsics(columns, rows, view)
        camera = np.eye(4)
        camera[:3, :3] = optical_rotation(pose[2])
        camera[:3, 3] = (pose[0], pose[1], height)
        picture = self._table.picture(camera, matrix, columns, rows)
        in_view = _in_view(self._boxes, camera, matrix, columns, rows)
        if any(in_view):
            self._show(in_view)
            self._draw_objects(picture, camera, matrix)
        return self._light.apply(picture, camera, matrix)

    def _draw_objects(self, picture: np.ndarray, camera: np.ndarray, matrix: np.ndarray) -> None:
        """Draw the visible objects over the table's picture (rows, columns, 3) uint8 from pose (4, 4) with K (3, 3)."""
        rows, columns = picture.shape[:2]
        _, _, colours, _, bodies = pybullet.getCameraImage(
            columns,
            rows,
            viewMatrix=_view_matrix(camera),
            projectionMatrix=_projection_matrix(matrix, columns, rows, 2.0 * camera[2, 3] + 1.0),
            renderer=pybullet.ER_TINY_RENDERER,
            physicsClientId=self._client,
            **_SHADING,
        )
        objects: np.ndarray = np.asarray(colours, dtype=np.uint8).reshape(rows, columns, 4)
        covered: np.ndarray = (np.asarray(bodies).reshape(rows, columns) >= 0).astype(np.uint8)
        cv2.copyTo(cv2.cvtColor(objects, cv2.COLOR_RGBA2RGB), covered, picture)

    def _show(self, in_view: List[bool]) -> None:
        """Hide objects out of view from the renderer, which would process all their triangles."""
        for item, body, visible, shown in zip(self._placed, self._bodies, in_view, self._shown):
            if visible != shown:
                # The renderer skips objects of opacity 0.
                colour = (*item.rgb, float(visible))
                pybullet.changeVisualShape(body, -1, rgbaColor=colour, physicsClientId=self._client)
        self._shown = in_view

    def _load(self, objects: Sequence[PlacedObject]) -> List[int]:
        """Load all objects from files written for the renderer; return their body ids."""
        written: Dict[Tuple[Path, bool], Path] = {}
        with tempfile.TemporaryDirectory(prefix="world-") as folder:
            bodies = []
            for item in objects:
                key = item.model.urdf, item.colour is None
                if key not in written:
                    written[key] = Path(folder) / f"{len(written)}.obj"
                    write_visual(item.model.shape, item.appearance, written[key])
                bodies.append(self._place(item, written[key]))
            return bodies

    def _place(self, item: PlacedObject, mesh: Path) -> int:
        """Create the body of an object; return its id."""
        model, yaw = item.model, pybullet.getQuaternionFromEuler((0.0, 0.0, item.yaw))
        try:
            shape = pybullet.createVisualShape(
                pybullet.GEOM_MESH,
                fileName=str(mesh),
                meshScale=[item.scale * value for value in model.mesh_scale],
                visualFramePosition=[item.scale * value for value in model.mesh_position],
                visualFrameOrientation=pybullet.getQuaternionFromEuler(model.mesh_rpy),
                rgbaColor=(*item.rgb, 1.0),
                physicsClientId=self._client,
            )
            return pybullet.createMultiBody(0.0, -1, shape, _origin(item), yaw, physicsClientId=self._client)
        except pybullet.error as error:
            raise WorldError(f"object {item.name}: PyBullet cannot load {model.mesh}: {error}") from error


def _view_matrix(camera: np.ndarray) -> Tuple[float, ...]:
    """OpenGL view matrix, column by column, of an optical frame (4, 4): OpenGL looks along -z with y up."""
    view = np.diag([1.0, -1.0, -1.0, 1.0]) @ np.linalg.inv(camera)
    return tuple(view.T.ravel())


def _projection_matrix(matrix: np.ndarray, columns: int, rows: int, far: float) -> Tuple[float, ...]:
    """OpenGL projection matrix, column by column, equivalent to K (3, 3)."""
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
    """Return for each box (N, 8, 3), m, whether it may be visible from camera pose (4, 4) with K (3, 3).

    A box with all corners beyond the same edge of the picture is not.
    """
    u, v, depth = np.moveaxis((boxes - camera[:3, 3]) @ camera[:3, :3] @ matrix.T, -1, 0)  # u and v times depth
    # One pixel of margin on each side, because the renderer has single precision.
    beyond = np.stack([u < -1.5 * depth, u > (columns + 0.5) * depth, v < -1.5 * depth, v > (rows + 0.5) * depth])
    return (~beyond.all(axis=-1).any(axis=0)).tolist()


def _origin(item: PlacedObject) -> np.ndarray:
    """(3,) position of the model's origin for which its mesh is centred on the position, at the height."""
    cosine, sine = math.cos(item.yaw), math.sin(item.yaw)
    x, y, _ = item.scale * item.model.centre
    bottom = item.scale * item.model.lower[2]
    turned = (cosine * x - sine * y, sine * x + cosine * y)
    return np.array([item.position[0] - turned[0], item.position[1] - turned[1], item.height - bottom])
