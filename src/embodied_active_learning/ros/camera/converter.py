"""Convert a driver's pictures to the model's images."""

from __future__ import annotations

from typing import Optional, Tuple, Union

from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.images import Framing, decode_compressed
from embodied_active_learning.ros import names
from embodied_active_learning.ros.camera.camera_info import ImageCalibration, image_calibration
from embodied_active_learning.ros.conversions import decode_image, image_message

Picture = Union[Image, CompressedImage]


class ImageConverter:
    """Converts pictures of any size and encoding: decode, rectify if calibrated, else crop the centre, and scale."""

    def __init__(self, camera: CameraConfig) -> None:
        self._camera = camera
        self._info: Optional[CameraInfo] = None
        self._framing: Optional[Framing] = None
        self._outdated = True
        self.calibration: Optional[ImageCalibration] = None
        """Calibration of the last picture; None before the first."""
        self.format = "unknown"
        """Size and encoding of the last picture."""

    @property
    def has_driver_info(self) -> bool:
        """Whether the driver has sent camera_info."""
        return self._info is not None

    def set_info(self, info: CameraInfo) -> None:
        """Store the driver's camera_info."""
        changed = self._info is None or _parameters(info) != _parameters(self._info)
        self._info = info
        if changed:
            self._outdated = True  # after the info: another thread may convert a picture in between

    def convert(self, picture: Picture) -> Tuple[Image, CameraInfo]:
        """Return image and camera_info with the picture's stamp. Raises ObservationError for an unusable picture."""
        raw = isinstance(picture, Image)
        array = decode_image(picture) if raw else decode_compressed(picture.data)
        height, width = array.shape[:2]
        self.format = f"{width} x {height}, {picture.encoding if raw else picture.format}"
        framing = Framing.between((height, width), (self._camera.height, self._camera.width))
        calibration = self._calibrate(framing)
        info = CameraInfo(**{name: getattr(calibration.info, name) for name in CameraInfo.__slots__})
        if calibration.rectification is not None:
            image = image_message(picture.header.stamp, calibration.rectification.apply(array))
        elif raw and framing.is_identity and (picture.encoding, picture.step) == ("rgb8", 3 * width):
            image = picture
            image.header.frame_id = names.CAMERA_FRAME
        else:
            image = image_message(picture.header.stamp, framing.apply(array))
        info.header = image.header
        return image, info

    def _calibrate(self, framing: Framing) -> ImageCalibration:
        if self.calibration is None or self._outdated or framing != self._framing:
            self._outdated, self._framing = False, framing  # before the info is read, which may change meanwhile
            self.calibration = image_calibration(self._info, framing, self._camera)
        return self.calibration


def _parameters(info: CameraInfo) -> Tuple:
    return info.height, info.width, info.distortion_model, tuple(info.D), tuple(info.K), tuple(info.R), tuple(info.P)
