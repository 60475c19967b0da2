"""The camera matrix of the model's images, without a master."""

from dataclasses import replace

import numpy as np
import pytest
import rospy
from sensor_msgs.msg import CameraInfo

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.geometry import field_of_view, intrinsics
from embodied_active_learning.images import Framing
from embodied_active_learning.ros.camera.camera_info import calibration_complaint, is_usable, model_camera_info
from embodied_active_learning.ros.conversions import camera_info_message

CAMERA = CameraConfig()
FRAMING = Framing.between((360, 640), (180, 180))
STAMP = rospy.Time(7)


def calibration(height=360, width=640, degrees=30.0):
    info = camera_info_message(rospy.Time(), intrinsics(width, height, degrees), height, width)
    info.K = np.add(info.K, (0, 0, 12.0, 0, 0, -4.0, 0, 0, 0)).tolist()
    info.D = [0.1, -0.2, 0.0, 0.0, 0.3]
    return info


@pytest.mark.parametrize("info", [None, CameraInfo(height=360, width=640)], ids=["silent", "not calibrated"])
def test_without_a_calibration_the_matrix_is_that_of_the_settings(info):
    message = model_camera_info(STAMP, info, FRAMING, CAMERA)
    np.testing.assert_allclose(np.reshape(message.K, (3, 3)), intrinsics(180, 180, 30.0))
    assert message.header.stamp == STAMP
    assert calibration_complaint(info, FRAMING, CAMERA) == ""


def test_a_calibration_is_scaled_with_the_picture_and_keeps_its_distortion():
    message = model_camera_info(STAMP, calibration(), FRAMING, CAMERA)
    matrix = np.reshape(message.K, (3, 3))
    assert field_of_view(matrix, 180) == pytest.approx(30.0)
    assert (matrix[0, 2], matrix[1, 2]) == pytest.approx((89.5 + 6.0, 89.5 - 2.0))
    assert message.D == calibration().D
    assert (message.height, message.width) == (180, 180)
    assert calibration_complaint(calibration(), FRAMING, CAMERA) == ""


def test_a_calibration_of_pictures_of_another_size_is_not_used_and_that_is_told():
    other = calibration(480, 640)
    assert not is_usable(other, FRAMING)
    assert model_camera_info(STAMP, other, FRAMING, CAMERA).K == model_camera_info(STAMP, None, FRAMING, CAMERA).K
    assert "is of 640 x 480 pixels, the camera's images have 640 x 360" in calibration_complaint(other, FRAMING, CAMERA)


def test_a_field_of_view_that_is_not_the_configured_one_is_told_with_both():
    complaint = calibration_complaint(calibration(degrees=33.0), FRAMING, CAMERA)
    assert "is 33.0 degrees, camera/field_of_view is 30.0" in complaint
    set_right = replace(CAMERA, field_of_view=33.0)
    assert calibration_complaint(calibration(degrees=33.0), FRAMING, set_right) == ""
