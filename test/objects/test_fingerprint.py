"""Validation of fingerprints and fingerprint sets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from embodied_active_learning.errors import ObservationError, SessionError
from sample_fingerprints import CONFIG, make_fingerprint, make_set


def test_thumbnail_is_nearest_view_regardless_of_yaw():
    states = np.array([[0.4, 0.2, 0.0], [0.41, 0.1, 2.0], [0.5, 0.1, 0.0]])
    fingerprint = make_fingerprint(states=states)
    np.testing.assert_array_equal(fingerprint.thumbnail, fingerprint.images[1])


def test_fingerprint_needs_at_least_one_view():
    assert make_fingerprint(views=1).thumbnail.shape == (8, 9, 3)
    with pytest.raises(ObservationError, match=r"object-1: states is float64 \(0, 3\), expected float64 \(V, 3\)"):
        make_fingerprint(views=0)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("centre", np.zeros(2), r"centre is float64 \(2,\), expected float64 \(3\)"),
        ("centre", np.zeros(3, np.float32), r"centre is float32 \(3,\)"),
        ("centre", [0.4, 0.1, 0.0], "centre is list"),
        ("centre", None, "centre is NoneType"),
        ("states", np.zeros((3, 2)), r"states is float64 \(3, 2\)"),
        ("states", np.zeros((3, 3), ">f8"), r"states is >f8 \(3, 3\)"),
        ("images", np.zeros((2, 8, 9, 3), np.uint8), r"images is uint8 \(2, 8, 9, 3\), expected uint8 \(3, H, W, 3\)"),
        ("images", np.zeros((3, 8, 9, 4), np.uint8), r"images is uint8 \(3, 8, 9, 4\)"),
        ("images", np.zeros((3, 8, 9), np.uint8), r"images is uint8 \(3, 8, 9\)"),
        ("images", np.zeros((3, 8, 9, 3)), r"images is float64"),
        ("latent_means", np.zeros((4, 2), np.float32), r"latent_means is float32 \(4, 2\), expected float32 \(3, L\)"),
        ("latent_means", np.zeros((3, 0), np.float32), r"latent_means is float32 \(3, 0\)"),
        ("latent_stds", np.ones((3, 1), np.float32), r"latent_stds is float32 \(3, 1\), expected float32 \(3, 2\)"),
        ("latent_stds", np.ones((3, 2)), r"latent_stds is float64"),
    ],
)
def test_wrong_dtype_or_shape_names_field(field, value, message):
    with pytest.raises(ObservationError, match=rf"object-1: {message}"):
        make_fingerprint(**{field: value})


@pytest.mark.parametrize("field", ["centre", "states", "latent_means", "latent_stds"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_non_finite_array_names_field(field, value):
    array = getattr(make_fingerprint(), field).copy()
    array.flat[-1] = value
    with pytest.raises(ObservationError, match=rf"object-1: {field} contains NaN or infinity"):
        make_fingerprint(**{field: array})


@pytest.mark.parametrize("value", [-0.1, 1.1, float("nan"), "1", None])
def test_importance_out_of_range_is_rejected(value):
    with pytest.raises(ObservationError, match=r"object-1: importance .* is out of range: expected 0 to 1"):
        make_fingerprint(importance=value)


@pytest.mark.parametrize("value", ["thing", "", None, ["object"]])
def test_invalid_kind_is_rejected(value):
    with pytest.raises(ObservationError, match=r"object-1: invalid kind .*: expected object or blank"):
        make_fingerprint(kind=value)


def test_unsafe_name_is_rejected():
    with pytest.raises(SessionError, match=r"name of a fingerprint is"):
        make_fingerprint(name="../x")
    with pytest.raises(SessionError, match=r"session of the fingerprints is"):
        make_set(session="../x")


def test_set_rejects_duplicate_names():
    """An empty set is valid."""
    assert make_set(fingerprints=()).fingerprints == ()
    with pytest.raises(ObservationError, match=r"duplicate fingerprint name in object-1, object-1: names"):
        make_set(fingerprints=(make_fingerprint(), make_fingerprint()))


@pytest.mark.parametrize(
    ("section", "key", "value", "message"),
    [
        ("camera", "width", 10, "object-1: images are 9 x 8 px but .* are 10 and 8"),
        ("camera", "height", 9, "object-1: images are 9 x 8 px but .* are 9 and 9"),
        ("model", "latent_size", 3, "object-1: made with 2 latents but model/latent_size is 3"),
    ],
)
def test_fingerprint_must_match_configuration(section, key, value, message):
    config = replace(CONFIG, **{section: replace(getattr(CONFIG, section), **{key: value})})
    with pytest.raises(ObservationError, match=message):
        make_set(config=config)


@pytest.mark.parametrize("field", ["updates", "observations"])
@pytest.mark.parametrize("value", [-1, 1.0, True, None, "1"])
def test_invalid_count_is_rejected(field, value):
    with pytest.raises(ObservationError, match=rf"invalid {field} .*: expected an integer of at least 0"):
        make_set(**{field: value})


@pytest.mark.parametrize("created", ["2026-11-22T12:45:00Z", "2026-11-22T12:45:00.125000+00:00"])
def test_utc_time_is_accepted(created):
    assert make_set(created=created).created == created


@pytest.mark.parametrize("created", ["", "today", "2026-11-22T12:45:00", "2026-11-22T12:45:00+02:00", None, 0])
def test_non_utc_time_is_rejected(created):
    with pytest.raises(ObservationError, match=r"invalid created .*: expected UTC"):
        make_set(created=created)
