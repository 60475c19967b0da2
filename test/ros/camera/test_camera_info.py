"""Calibration of the model's images, without a master."""

import cv2
import numpy as np
import pytest
import rospy
from sensor_msgs.msg import CameraInfo, Image

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.geometry import field_of_view, intrinsics
from embodied_active_learning.images import Framing
from embodied_active_learning.ros.camera.camera_info import image_calibration
from embodied_active_learning.ros.camera.converter import ImageConverter
from embodied_active_learning.ros.camera.rectification import pixel_rays
from embodied_active_learning.ros.conversions import camera_info_message, image_array

CAMERA = CameraConfig()
FRAMING = Framing.between((360, 640), (180, 180))
STAMP = rospy.Time(7)


def calibration(height=360, width=640, degrees=30.0, axis=(0.0, 0.0), aspect=1.0, model="plumb_bob", distortion=()):
    """camera_info of a driver; axis: offset of the optical axis in pixels."""
    info = camera_info_message(rospy.Time(), intrinsics(width, height, degrees), height, width)
    info.K = np.add(info.K, (0, 0, axis[0], 0, 0, axis[1], 0, 0, 0)).tolist()
    info.K[0] *= aspect
    info.D, info.distortion_model = list(distortion), model
    return info


def camera_matrix(info):
    return np.reshape(info.K, (3, 3))


@pytest.mark.parametrize("info", [None, CameraInfo(height=360, width=640)], ids=["none", "zeros"])
def test_uncalibrated_camera_uses_configured_field_of_view(info):
    found = image_calibration(info, FRAMING, CAMERA)
    np.testing.assert_allclose(camera_matrix(found.info), intrinsics(180, 180, 30.0))
    assert found.warning == ""
    assert found.rectification is None
    assert "camera/field_of_view, without a calibration" in found.source


def test_matching_calibration_is_scaled_and_not_rectified():
    found = image_calibration(calibration(axis=(0.5, -0.5)), FRAMING, CAMERA)
    matrix = camera_matrix(found.info)
    assert field_of_view(matrix, 180) == pytest.approx(30.0)
    assert (matrix[0, 2], matrix[1, 2]) == pytest.approx((89.5 + 0.25, 89.5 - 0.25))
    assert (found.info.height, found.info.width) == (180, 180)
    assert found.warning == ""
    assert found.rectification is None


def test_calibration_of_other_size_is_ignored_with_warning():
    found = image_calibration(calibration(480, 640), FRAMING, CAMERA)
    assert found.info.K == image_calibration(None, FRAMING, CAMERA).info.K
    assert "is for 640 x 480 pixels, the camera's pictures have 640 x 360" in found.warning


def test_narrow_field_of_view_is_reported_with_both_values():
    """The pictures do not cover the configured field of view, so they cannot be rectified."""
    info = calibration(degrees=27.0, distortion=(0.1, -0.2, 0.0, 0.0, 0.3))
    found = image_calibration(info, FRAMING, CAMERA)
    assert found.rectification is None
    assert "camera/field_of_view is 30.0 degrees, the calibrated camera has field of view 27.0 degrees" in found.warning
    assert "set camera/field_of_view to 26.9 or less" in found.warning
    assert field_of_view(camera_matrix(found.info), 180) == pytest.approx(27.0)
    assert found.info.D == info.D
    remedied = CameraConfig(field_of_view=26.9)
    assert image_calibration(info, FRAMING, remedied).warning == ""


WRONG = {
    "wide": ({"degrees": 33.0}, "field of view 33.0 degrees"),
    "axis": ({"degrees": 40.0, "axis": (40.0, -12.0)}, "optical axis +20.0, -6.0 px off centre"),
    "aspect": ({"degrees": 40.0, "aspect": 1.2}, "fx/fy 1.200"),
    "barrel": ({"degrees": 36.0, "distortion": (-0.35, 0.12, 0.0, 0.0, 0.0)}, "distortion plumb_bob"),
    "rational": (
        {"degrees": 36.0, "model": "rational_polynomial", "distortion": (0.2, 0.1, 0, 0, 0, 0.3, 0.1, 0)},
        "distortion rational_polynomial",
    ),
    "fisheye": (
        {"degrees": 36.0, "model": "equidistant", "distortion": (0.1, -0.8, 1.2, -0.4)},
        "distortion equidistant",
    ),
}


@pytest.mark.parametrize(("values", "words"), WRONG.values(), ids=WRONG)
def test_deviating_camera_is_rectified(values, words):
    found = image_calibration(calibration(**values), FRAMING, CAMERA)
    assert found.warning == ""
    assert found.rectification is not None
    assert words in found.source
    assert "mm on the table" in found.source
    np.testing.assert_allclose(camera_matrix(found.info), intrinsics(180, 180, 30.0))
    assert not np.any(found.info.D)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"axis": (0.0, 40.0)}, "wrong by up to 17.9 mm"),  # 40 of 360 px; the table in view is 161 mm high
        ({"aspect": 1.2}, "fx/fy 1.200"),
        ({"distortion": (0.35, 0.12, 0.0, 0.0, 0.0)}, "distortion plumb_bob"),
        ({"model": "equidistant", "distortion": (2.0, 0.0, 0.0, 0.0)}, "distortion equidistant"),
    ],
    ids=["axis", "aspect", "pincushion", "fisheye"],
)
def test_deviating_camera_that_cannot_be_rectified_is_reported(values, words):
    """A square picture with exactly the configured field of view covers nothing beyond it."""
    found = image_calibration(calibration(360, 360, **values), Framing.between((360, 360), (180, 180)), CAMERA)
    assert found.rectification is None
    assert "positions on the table are wrong by up to" in found.warning
    assert "set camera/field_of_view to" in found.warning
    assert words in found.warning


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"model": "mei", "distortion": (1.0, 2.0)}, "distortion model 'mei' is not supported"),
        ({"distortion": (0.1, 0.2, 0.3)}, "plumb_bob has 3 coefficients, expected 4 or 5"),
        ({"distortion": (np.nan, 0.0, 0.0, 0.0, 0.0)}, "not finite"),
    ],
)
def test_unusable_distortion_is_reported(values, words):
    found = image_calibration(calibration(**values), FRAMING, CAMERA)
    assert words in found.warning
    assert "rectify the pictures with image_proc" in found.warning


def table_pattern(rays):
    """Grey level (N,) that a camera sees in directions (N, 2): waves on the table, finer than an object."""
    return 127.0 + 60.0 * np.sin(90.0 * rays[:, 0]) + 60.0 * np.cos(70.0 * rays[:, 1])


@pytest.mark.parametrize(("values", "words"), WRONG.values(), ids=WRONG)
def test_rectified_image_is_that_of_configured_camera(values, words):
    """Pictures are synthesised with OpenCV's inverse of the lens model."""
    info = calibration(**values)
    columns, rows = np.meshgrid(np.arange(640.0), np.arange(360.0))
    pixels = np.stack([columns, rows], axis=-1).reshape(-1, 1, 2)
    fisheye = info.distortion_model == "equidistant"
    undistort = cv2.fisheye.undistortPoints if fisheye else cv2.undistortPoints
    rays = undistort(pixels, camera_matrix(info), np.array(info.D) if info.D else np.zeros(5)).reshape(-1, 2)
    picture = np.repeat(np.rint(np.clip(table_pattern(rays), 0, 255)).astype(np.uint8), 3)
    converter = ImageConverter(CAMERA)
    converter.set_info(info)
    message = Image(height=360, width=640, encoding="rgb8", step=3 * 640, data=picture.tobytes())
    message.header.stamp = STAMP
    image, image_info = converter.convert(message)
    assert image.header.stamp == image_info.header.stamp == STAMP
    expected = table_pattern(pixel_rays(180, 180, 30.0)).reshape(180, 180)
    np.testing.assert_allclose(image_array(image, 180, 180)[:, :, 0], expected, atol=3.0)


def test_new_calibration_replaces_the_old_one():
    converter = ImageConverter(CAMERA)
    message = Image(height=360, width=640, encoding="rgb8", step=3 * 640, data=bytes(3 * 640 * 360))
    converter.set_info(calibration(degrees=27.0))
    converter.convert(message)
    assert "27.0 degrees" in converter.calibration.warning
    converter.set_info(calibration(degrees=33.0))
    _, info = converter.convert(message)
    assert converter.calibration.rectification is not None
    assert field_of_view(camera_matrix(info), 180) == pytest.approx(30.0)


def test_picture_converted_while_calibration_changes():
    """The next picture uses the new calibration, whenever another thread converted the last one."""

    class ConverterWithThread(ImageConverter):
        def __setattr__(self, name, value):
            super().__setattr__(name, value)
            if value and name in ("_info", "_outdated") and vars(self).get("calibration"):
                self.convert(message)

    message = Image(height=360, width=640, encoding="rgb8", step=3 * 640, data=bytes(3 * 640 * 360))
    converter = ConverterWithThread(CAMERA)
    converter.set_info(calibration(degrees=27.0))
    converter.convert(message)
    converter.set_info(calibration(degrees=33.0))
    converter.convert(message)
    assert converter.calibration.rectification is not None
