"""A fingerprint is checked when it is made: what is wrong with it is said there and by name."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest

from embodied_active_learning.errors import ObservationError, SessionError
from sample_fingerprints import CONFIG, make_fingerprint, make_set


def test_thumbnail_is_the_view_nearest_in_x_and_y_whatever_its_angle():
    states = np.array([[0.4, 0.2, 0.0], [0.41, 0.1, 2.0], [0.5, 0.1, 0.0]])
    fingerprint = make_fingerprint(states=states)
    np.testing.assert_array_equal(fingerprint.thumbnail, fingerprint.images[1])


def test_fingerprint_stays_as_it_was_made():
    with pytest.raises(FrozenInstanceError):
        make_fingerprint().name = "object-2"


def test_one_view_is_enough_and_none_is_refused():
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
def test_array_of_another_type_or_shape_is_refused_by_name(field, value, message):
    with pytest.raises(ObservationError, match=rf"object-1: {message}"):
        make_fingerprint(**{field: value})


@pytest.mark.parametrize("field", ["centre", "states", "latent_means", "latent_stds"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_array_that_is_not_finite_is_refused_by_name(field, value):
    array = getattr(make_fingerprint(), field).copy()
    array.flat[-1] = value
    with pytest.raises(ObservationError, match=rf"object-1: {field} holds values that are not finite"):
        make_fingerprint(**{field: array})


@pytest.mark.parametrize("value", [-0.1, 1.1, float("nan"), "1", None])
def test_importance_that_is_no_share_is_refused(value):
    with pytest.raises(ObservationError, match=r"object-1: importance is .*: legal is 0 to 1"):
        make_fingerprint(importance=value)


@pytest.mark.parametrize("value", ["thing", "", None, ["object"]])
def test_kind_that_does_not_exist_is_refused(value):
    with pytest.raises(ObservationError, match=r"object-1: kind is .*: legal are object, blank"):
        make_fingerprint(kind=value)


@pytest.mark.parametrize("name", ["", "../x", "a/b", ".hidden", "Object", None])
def test_name_that_is_not_safe_as_a_folder_is_refused(name):
    with pytest.raises(SessionError, match=r"name of a fingerprint is"):
        make_fingerprint(name=name)
    with pytest.raises(SessionError, match=r"session of the fingerprints is"):
        make_set(session=name)


def test_set_may_be_empty_but_not_hold_a_name_twice():
    assert make_set(fingerprints=()).fingerprints == ()
    with pytest.raises(ObservationError, match=r"names of fingerprints are object-1, object-1: give each its own"):
        make_set(fingerprints=(make_fingerprint(), make_fingerprint()))


@pytest.mark.parametrize(
    ("section", "key", "value", "message"),
    [
        ("camera", "width", 10, "object-1: images are 9 x 8 px, but .* are 10 and 8"),
        ("camera", "height", 9, "object-1: images are 9 x 8 px, but .* are 9 and 9"),
        ("model", "latent_size", 3, "object-1: latent_means has 2 latent variables, but model/latent_size is 3"),
    ],
)
def test_fingerprint_that_does_not_fit_the_configuration_is_refused(section, key, value, message):
    config = replace(CONFIG, **{section: replace(getattr(CONFIG, section), **{key: value})})
    with pytest.raises(ObservationError, match=message):
        make_set(config=config)


@pytest.mark.parametrize("field", ["updates", "observations"])
@pytest.mark.parametrize("value", [-1, 1.0, True, None, "1"])
def test_count_that_is_no_whole_number_is_refused(field, value):
    with pytest.raises(ObservationError, match=rf"{field} is .*: give a whole number"):
        make_set(**{field: value})


@pytest.mark.parametrize("created", ["2026-11-22T12:45:00Z", "2026-11-22T12:45:00.125000+00:00"])
def test_time_in_utc_is_taken(created):
    assert make_set(created=created).created == created


@pytest.mark.parametrize("created", ["", "today", "2026-11-22T12:45:00", "2026-11-22T12:45:00+02:00", None, 0])
def test_time_that_is_not_utc_is_refused(created):
    with pytest.raises(ObservationError, match=r"created is .*: give a UTC time"):
        make_set(created=created)
