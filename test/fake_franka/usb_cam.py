"""Simulated usb_cam_node at the robot's wrist."""

from __future__ import annotations

from collections import deque
from typing import Callable, Deque, Optional, Tuple

import cv2
import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from embodied_active_learning.config import Config
from embodied_active_learning.ros.conversions import camera_info_message
from fake_franka.camera import ENCODINGS, TableCamera, encode
from fake_franka.computer import Computer, Every

FRAME = "camera_optical_frame"
"""Frame of the images, as set in launch/franka_hardware.launch."""


class FakeUsbCam:
    """Publishes usb_cam/image_raw, usb_cam/image_raw/compressed and usb_cam/camera_info."""

    def __init__(self, pose: Callable[[], np.ndarray], config: Config, computer: Computer) -> None:
        """pose: returns the present pose (4, 4) of the optical frame."""
        self._pose = pose
        self._computer = computer
        width, height = rospy.get_param("~image_width", 640), rospy.get_param("~image_height", 360)
        self._encoding = rospy.get_param("~encoding", ENCODINGS[0])
        if self._encoding not in ENCODINGS:
            raise ValueError(f"~encoding is {self._encoding}: legal are {', '.join(ENCODINGS)}")
        self._camera = TableCamera(config, rospy.get_param("~world", config.simulation.world), width, height)
        self.is_frozen = False
        """Whether to repeat the last image with new stamps."""
        self.is_silent = False
        self._frame: Optional[np.ndarray] = None
        self._images = rospy.Publisher("usb_cam/image_raw", Image, queue_size=1)
        self._compressed = rospy.Publisher("usb_cam/image_raw/compressed", CompressedImage, queue_size=1)
        self._info = rospy.Publisher("usb_cam/camera_info", CameraInfo, queue_size=1)
        self._delayed: Deque[Tuple[rospy.Time, np.ndarray]] = deque()
        self._latency = rospy.Duration(float(rospy.get_param("~latency", 0.0)))
        rate = float(rospy.get_param("~framerate", 15.0))
        Every(lambda: rate, self.publish)

    def publish(self) -> None:
        """Publish an image, stamped ~latency after the camera was at the pose it shows."""
        if self.is_silent or not self._computer.is_alive:
            return
        now = rospy.Time.now()
        self._delayed.append((now + self._latency, self._pose()))
        if self._delayed[0][0] > now:
            return
        stamp, pose = self._delayed.popleft()
        if self._frame is None or not self.is_frozen:
            self._frame = self._camera.frame(pose)
        height, width, _ = self._frame.shape
        message = Image(height=height, width=width, encoding=self._encoding, is_bigendian=0)
        message.header.stamp, message.header.frame_id = stamp, FRAME
        message.data, message.step = encode(self._frame, self._encoding)
        self._images.publish(message)
        if self._compressed.get_num_connections():
            _, data = cv2.imencode(".jpg", self._frame[..., ::-1])
            self._compressed.publish(
                CompressedImage(message.header, f"{self._encoding}; jpeg compressed bgr8", data.tobytes())
            )
        info = camera_info_message(stamp, self._camera.intrinsics(), height, width)
        info.header.frame_id = FRAME
        self._info.publish(info)
