"""Images of any size and encoding: known colours, exact round trips, and untrusted bytes."""

import struct
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from embodied_active_learning.errors import ObservationError
from embodied_active_learning.images import (
    ENCODINGS,
    MAX_DATA,
    Framing,
    decode_compressed,
    decode_raw,
)

BYTES_PER_PIXEL = {"mono8": 1, "rgb8": 3, "bgr8": 3, "rgba8": 4, "bgra8": 4}  # all others 2
# BT.601 with Y 16 .. 235 and U, V 16 .. 240: (Y, U, V) of colours at full strength.
BARS = {
    (0, 0, 0): (16, 128, 128),
    (255, 255, 255): (235, 128, 128),
    (255, 0, 0): (81, 90, 240),
    (0, 255, 0): (145, 54, 34),
    (0, 0, 255): (41, 240, 110),
    (255, 255, 0): (210, 16, 146),
}


def noise(height=12, width=20, channels=3, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (height, width, channels), dtype=np.uint8)


def colours(height=48, width=64):
    """Smooth, so that compression changes it little; no two channels are alike."""
    rows, columns = np.mgrid[0:height, 0:width]
    return np.stack([4 * columns, 5 * rows, 255 - 2 * rows - columns], axis=-1).clip(0, 255).astype(np.uint8)


def decode(array, encoding, padding=0):
    height, width = array.shape[:2]
    rows = np.pad(array.reshape(height, -1), ((0, 0), (0, padding)), constant_values=77)
    return decode_raw(rows.tobytes(), encoding, height, width, rows.shape[1])


def png(picture):
    return cv2.imencode(".png", picture[..., ::-1])[1].tobytes()


def jpeg(picture, quality=95):
    return cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def packed(order, colour, width=4, height=2):
    """A picture of one colour in a 4:2:2 encoding: the order of Y, U and V in two pixels."""
    values = dict(zip("YUV", colour))
    return np.array([values[name] for name in order] * (width // 2) * height, np.uint8).reshape(height, width, 2)


@pytest.mark.parametrize("padding", [0, 5])
def test_channel_orders_give_the_same_image(padding):
    picture = noise()
    alpha = np.full((*picture.shape[:2], 1), 9, np.uint8)
    for encoding, array in {
        "rgb8": picture,
        "bgr8": picture[..., ::-1],
        "rgba8": np.concatenate([picture, alpha], axis=-1),
        "bgra8": np.concatenate([picture[..., ::-1], alpha], axis=-1),
    }.items():
        np.testing.assert_array_equal(decode(array, encoding, padding), picture, encoding)


def test_grey_image_has_equal_channels():
    grey = noise(channels=1)
    np.testing.assert_array_equal(decode(grey, "mono8", 3), np.repeat(grey, 3, axis=-1))


@pytest.mark.parametrize(("rgb", "yuv"), BARS.items(), ids=str)
@pytest.mark.parametrize(
    ("encoding", "order"), [("yuyv", "YUYV"), ("yuv422_yuy2", "YUYV"), ("yuv422", "UYVY"), ("uyvy", "UYVY")]
)
def test_yuv_is_decoded_as_bt601(encoding, order, rgb, yuv):
    found = decode(packed(order, yuv), encoding, padding=6)
    np.testing.assert_allclose(found, np.broadcast_to(rgb, found.shape), atol=3)


@pytest.mark.parametrize(("encoding", "code"), [("yuyv", cv2.COLOR_YUV2RGB_YUY2), ("yuv422", cv2.COLOR_YUV2RGB_UYVY)])
def test_yuv_matches_opencv(encoding, code):
    array = noise(channels=2)
    np.testing.assert_array_equal(decode(array, encoding, 4), cv2.cvtColor(array, code))


def test_grey_scale_survives_yuv_round_trip():
    grey = np.arange(16, 236, dtype=np.uint8).reshape(10, 22)
    array = np.stack([grey, np.full_like(grey, 128)], axis=-1)
    found = decode(array, "yuyv").astype(int)
    assert np.ptp(found, axis=-1).max() == 0
    np.testing.assert_allclose(found[..., 0], (grey.astype(float) - 16) * 255 / 219, atol=1)


def test_png_is_lossless():
    np.testing.assert_array_equal(decode_compressed(png(noise())), noise())


def test_jpeg_keeps_colours():
    np.testing.assert_allclose(decode_compressed(jpeg(colours())).astype(int), colours().astype(int), atol=12)


def test_jpeg_with_zero_padding_is_decoded():
    data = jpeg(colours())
    np.testing.assert_array_equal(decode_compressed(data + bytes(100)), decode_compressed(data))


def test_exif_rotation_is_ignored():
    orientation = b"Exif\0\0" + b"MM\0*\0\0\0\x08" + b"\0\x01" + b"\x01\x12\0\x03\0\0\0\x01\0\x06\0\0" + b"\0\0\0\0"
    data = jpeg(colours())
    turned = data[:2] + b"\xff\xe1" + struct.pack(">H", len(orientation) + 2) + orientation + data[2:]
    assert cv2.imdecode(np.frombuffer(turned, np.uint8), cv2.IMREAD_COLOR).shape == (64, 48, 3), "the note counts"
    np.testing.assert_array_equal(decode_compressed(turned), decode_compressed(data))


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"encoding": "bayer_rggb8"}, "unsupported image encoding 'bayer_rggb8': set one of rgb8, bgr8"),
        ({"data": bytes(719)}, "image has 719 bytes in rows of 60: expected 12 rows of 60 bytes or more"),
        ({"step": 59, "data": bytes(59 * 12)}, "in rows of 59: expected 12 rows of 60"),
        ({"height": 0, "data": b""}, "image is 20 x 0 pixels"),
        ({"width": 0}, "image is 0 x 12 pixels"),
        ({"width": 9000, "step": 27000, "data": bytes(27000 * 12)}, "image is 9000 x 12 pixels"),
        ({"encoding": "yuyv", "width": 19}, "image is 19 pixels wide: encoding yuyv requires"),
    ],
)
def test_inconsistent_raw_image_is_rejected(change, expected):
    message = {"data": bytes(720), "encoding": "rgb8", "height": 12, "width": 20, "step": 60, **change}
    with pytest.raises(ObservationError, match=expected):
        decode_raw(**message)


def bomb(size):
    """A PNG file of a few bytes that says it is huge, with checksums that are right."""
    header = b"IHDR" + struct.pack(">IIBBBBB", size, size, 8, 2, 0, 0, 0)
    parts = (header, b"IDAT" + zlib.compress(b"\0" * 1000), b"IEND")
    chunks = (struct.pack(">I", len(part) - 4) + part + struct.pack(">I", zlib.crc32(part)) for part in parts)
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"", "begins with nothing, expected JPEG or PNG"),
        (b"GIF89a", "begins with 47 49 46 38, expected JPEG or PNG"),
        (jpeg(colours())[:-300], "damaged, its end is missing"),
        (png(colours())[:-30], "damaged, its end is missing"),
        (png(colours())[:20], "damaged, its end is missing"),
        (b"\xff\xd8\xff\xd9", "damaged, its size is missing"),
        (png(colours()).replace(b"IDAT", b"IDAT"[::-1]), "a checksum in it is wrong"),
        (png(16 * colours().astype(np.uint16)), "has 16 bits per channel: set 8 bits"),
        (bomb(60000), "image is 60000 x 60000 pixels"),
        (bomb(100), "its content cannot be decoded"),
        (bytes(MAX_DATA + 1), "at most"),
    ],
    ids=lambda value: value[:12] if isinstance(value, str) else f"{len(value)} bytes",
)
def test_invalid_compressed_image_is_rejected(data, expected):
    with pytest.raises(ObservationError, match=expected):
        decode_compressed(data)


def test_large_jpeg_is_rejected_before_decoding(monkeypatch):
    data = bytearray(jpeg(colours()))
    at = data.index(b"\xff\xc0")
    data[at + 5 : at + 9] = struct.pack(">HH", 65535, 65535)
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("it was decoded"))
    with pytest.raises(ObservationError, match="image is 65535 x 65535 pixels"):
        decode_compressed(bytes(data))


SIZES = st.integers(0, 40)


@given(st.sampled_from([*ENCODINGS, "", "rgb16"]), SIZES, SIZES, st.integers(0, 200), st.integers(-3, 3), st.data())
def test_random_raw_bytes_give_image_or_error(encoding, height, width, step, slip, data):
    step = data.draw(st.sampled_from([step, width * BYTES_PER_PIXEL.get(encoding, 2)]))
    length = max(0, height * step + slip) if step else 0
    random = data.draw(st.randoms(use_true_random=False))
    content = random.getrandbits(8 * length).to_bytes(length, "little") if length else b""
    try:
        picture = decode_raw(content, encoding, height, width, step)
    except ObservationError:
        return
    assert picture.shape == (height, width, 3)
    assert picture.dtype == np.uint8


@given(st.sampled_from([jpeg(colours(), 60), png(colours(12, 16))]), st.data())
def test_damaged_compressed_image_gives_image_or_error(whole, data):
    damaged = bytearray(whole)
    for at in data.draw(st.lists(st.integers(0, len(whole) - 1), max_size=4)):
        damaged[at] = data.draw(st.integers(0, 255))
    del damaged[data.draw(st.sampled_from([len(whole), *range(0, len(whole), 7)])) :]
    try:
        picture = decode_compressed(bytes(damaged))
    except ObservationError:
        return
    assert picture.ndim == 3
    assert picture.dtype == np.uint8


def test_framing_keeps_centre_of_wide_image():
    picture = np.zeros((360, 640, 3), np.uint8)
    picture[:, :140] = picture[:, 500:] = 255
    image = Framing.between((360, 640), (180, 180)).apply(picture)
    assert image.shape == (180, 180, 3)
    assert image.max() == 0


def test_downscaling_averages_pixels():
    picture = noise(40, 60)
    image = Framing.between((40, 60), (10, 10)).apply(picture)
    expected = picture[:, 10:50].reshape(10, 4, 10, 4, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(image, expected, atol=0.51)


def test_image_of_model_size_is_unchanged():
    picture = noise()
    assert Framing.between((12, 20), (12, 20)).apply(picture) is picture


EXTENTS = st.integers(1, 700)


@given(EXTENTS, EXTENTS, EXTENTS, EXTENTS)
def test_framing_crops_largest_part_of_any_size(height, width, rows, columns):
    framing = Framing.between((height, width), (rows, columns))
    assert framing.apply(np.zeros((height, width, 3), np.uint8)).shape == (rows, columns, 3)
    assert framing.part[0] == height or framing.part[1] == width, "nothing is cut off on both axes"
    for have, part, other_part, want, other in zip(
        framing.source, framing.part, framing.part[::-1], framing.size, framing.size[::-1]
    ):
        assert part <= have
        assert abs(part - other_part * want / other) <= max(1, want / other)


@pytest.mark.parametrize("source", [(360, 640), (480, 640), (91, 120), (640, 360)])
def test_framing_matrix_maps_points(source):
    framing = Framing.between(source, (60, 60))
    row, column = source[0] // 2 + 7, source[1] // 2 - 11
    picture = np.zeros((*source, 3), np.float32)
    picture[row - 6 : row + 7, column - 6 : column + 7] = 1.0
    weights = framing.apply(picture)[..., 0]
    rows, columns = np.mgrid[0:60, 0:60]
    found = [(weights * axis).sum() / weights.sum() for axis in (columns, rows)]
    np.testing.assert_allclose(found, (framing.matrix() @ [column, row, 1.0])[:2], atol=0.1)
