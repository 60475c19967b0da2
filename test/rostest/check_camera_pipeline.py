#!/usr/bin/env python3
"""Node camera_pipeline: pictures of every encoding become the model's images; others are dropped and reported."""

import threading
import unittest

import cv2
import numpy as np
import rospy
import search_path  # noqa: F401  for the helpers below
from diagnostic_msgs.msg import DiagnosticArray
from rosgraph_msgs.msg import Log
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

import rostest
from embodied_active_learning.geometry import field_of_view, intrinsics
from embodied_active_learning.ros.conversions import camera_info_message, image_array
from threads import wait_for

TIMEOUT = 30.0
HEIGHT, WIDTH = 360, 640


def checkerboard():
    """A wide picture: squares of 80 pixels in two colours in the middle, white at the sides."""
    rows, columns = np.mgrid[0:HEIGHT, 0:HEIGHT] // 80
    middle = np.where((rows + columns)[..., None] % 2, (200, 60, 20), (20, 60, 200))
    picture = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
    picture[:, (WIDTH - HEIGHT) // 2 : (WIDTH + HEIGHT) // 2] = middle
    return picture


def packed(picture):
    """Encode a picture in 4:2:2, as u y v y; here, pixels that share their chroma have equal colours."""
    y, v, u = np.moveaxis(cv2.cvtColor(picture, cv2.COLOR_RGB2YCrCb).astype(float), -1, 0)
    y, u, v = 16 + y * 219 / 255, 128 + (u - 128) * 224 / 255, 128 + (v - 128) * 224 / 255
    pixels = np.empty((HEIGHT, WIDTH, 2), np.uint8)
    pixels[..., 1] = np.rint(y)
    pixels[:, 0::2, 0], pixels[:, 1::2, 0] = np.rint(u[:, 0::2]), np.rint(v[:, 1::2])
    return pixels


class Inbox:
    """Messages received on a topic."""

    def __init__(self, topic, message_class):
        self._messages, self._condition = [], threading.Condition()
        self.subscriber = rospy.Subscriber(topic, message_class, self._add)

    def _add(self, message):
        with self._condition:
            self._messages.append(message)
            self._condition.notify_all()

    def wait_for(self, wanted):
        with self._condition:
            found = self._condition.wait_for(lambda: [item for item in self._messages if wanted(item)], TIMEOUT)
        assert found, "no such message arrived"
        return found[-1]


class CameraPipelineTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.camera = rospy.Publisher("usb_cam/image_raw", Image, queue_size=1)
        cls.calibration = rospy.Publisher("usb_cam/camera_info", CameraInfo, queue_size=1)
        cls.compressed = rospy.Publisher("compressed/usb_cam/image_raw/compressed", CompressedImage, queue_size=1)
        cls.images, cls.infos = Inbox("camera/image_raw", Image), Inbox("camera/camera_info", CameraInfo)
        cls.from_compressed = Inbox("compressed/camera/image_raw", Image)
        cls.log, cls.diagnostics = Inbox("/rosout", Log), Inbox("/diagnostics", DiagnosticArray)
        received = (cls.images, cls.infos, cls.from_compressed)
        ends = (cls.camera, cls.calibration, cls.compressed, *(inbox.subscriber for inbox in received))
        deadline = rospy.get_time() + TIMEOUT
        while not all(end.get_num_connections() for end in ends):
            assert rospy.get_time() < deadline, "the nodes did not start"
            rospy.rostime.wallsleep(0.05)
        cls.stamp = rospy.Time(100)

    def next_stamp(self):
        type(self).stamp += rospy.Duration(0, 33333333)
        return self.stamp

    def show(self, array, encoding, padding=0):
        """Publish a picture -> the resulting image."""
        rows = np.pad(array.reshape(array.shape[0], -1), ((0, 0), (0, padding)))
        header = Header(stamp=self.next_stamp(), frame_id="head_camera")
        height, width = array.shape[:2]
        self.camera.publish(Image(header, height, width, encoding, 0, rows.shape[1], rows.tobytes()))
        return self.images.wait_for(lambda message: message.header.stamp == header.stamp)

    def shown_info(self):
        """Publish a picture -> the camera info of the resulting image."""
        self.show(checkerboard(), "rgb8")
        return self.infos.wait_for(lambda message: message.header.stamp == self.stamp)

    def test_every_encoding_is_converted_with_its_stamp(self):
        picture = checkerboard()
        expected = cv2.resize(picture[:, 140:500], (180, 180), interpolation=cv2.INTER_AREA)
        alpha = np.full((HEIGHT, WIDTH, 1), 255, np.uint8)
        for encoding, array, tolerance in (
            ("rgb8", picture, 0),
            ("bgr8", picture[..., ::-1], 0),
            ("rgba8", np.concatenate([picture, alpha], axis=-1), 0),
            ("yuv422", packed(picture), 4),
        ):
            with self.subTest(encoding):
                message = self.show(array, encoding, padding=16)
                self.assertEqual(message.header.frame_id, "camera_optical_frame")
                image = image_array(message, 180, 180)
                np.testing.assert_allclose(image.astype(int), expected, atol=tolerance)

    def test_compressed_transport_is_selectable(self):
        picture = checkerboard()
        for ending in ("png", "jpg"):
            with self.subTest(ending):
                _, data = cv2.imencode(f".{ending}", picture[..., ::-1])
                header = Header(stamp=self.next_stamp())
                self.compressed.publish(CompressedImage(header, f"rgb8; {ending} compressed bgr8", data.tobytes()))
                message = self.from_compressed.wait_for(
                    lambda message, stamp=header.stamp: message.header.stamp == stamp
                )
                image = image_array(message, 180, 180).astype(int)
                np.testing.assert_allclose(image[20, 20], (20, 60, 200), atol=12)
                np.testing.assert_allclose(image[20, 60], (200, 60, 20), atol=12)

    def test_camera_mount_of_real_arm_is_in_tf(self):
        (transform,) = Inbox("compressed/tf_static", TFMessage).wait_for(lambda message: True).transforms
        self.assertEqual((transform.header.frame_id, transform.child_frame_id), ("panda_EE", "camera_optical_frame"))
        place, turn = transform.transform.translation, transform.transform.rotation
        self.assertEqual((place.x, place.y, place.z), (0.05, 0.0, 0.02))
        self.assertAlmostEqual(2.0 * np.arctan2(turn.z, turn.w), 1.5)

    def test_camera_info_is_of_image_and_wrong_view_is_logged(self):
        info = self.shown_info()
        self.assertAlmostEqual(field_of_view(np.reshape(info.K, (3, 3)), info.height), 30.0)
        narrow = camera_info_message(rospy.Time(), intrinsics(WIDTH, HEIGHT, 20.0), HEIGHT, WIDTH)
        narrow.D = [0.1, -0.2, 0.0, 0.0, 0.0]
        self.calibration.publish(narrow)
        wait_for(lambda: self.shown_info().D[0], timeout=TIMEOUT)  # the calibration has a connection of its own
        info = self.shown_info()
        self.assertEqual((info.height, info.width, info.header.frame_id), (180, 180, "camera_optical_frame"))
        self.assertAlmostEqual(field_of_view(np.reshape(info.K, (3, 3)), info.height), 20.0)
        np.testing.assert_allclose((info.K[2], info.K[5]), 89.5)
        logged = self.log.wait_for(lambda message: "positions on the table are wrong" in message.msg).msg
        self.assertIn("field_of_view is 30.0 degrees, the calibrated camera has field of view 20.0 degrees", logged)

    def test_unusable_pictures_are_dropped_and_reported(self):
        for _ in range(3):
            header = Header(stamp=self.next_stamp())
            self.camera.publish(Image(header, HEIGHT, WIDTH, "bayer_rggb8", 0, WIDTH, bytes(HEIGHT * WIDTH)))
            status_array = self.diagnostics.wait_for(
                lambda message: any("bayer_rggb8" in status.message for status in message.status)
            )
        status = next(status for status in status_array.status if "bayer_rggb8" in status.message)
        self.assertEqual(status.level, status.WARN)
        values = {item.key: item.value for item in status.values}
        self.assertGreaterEqual(int(values["images dropped"]), 1)
        self.log.wait_for(lambda message: "dropped" in message.msg and "bayer_rggb8" in message.msg)
        self.show(checkerboard(), "rgb8")


if __name__ == "__main__":
    rospy.init_node("check_camera_pipeline")
    rostest.rosrun("embodied_active_learning", "check_camera_pipeline", CameraPipelineTest)
