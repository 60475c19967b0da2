"""Pictures of visited places."""

import cv2
import numpy as np
import pytest

from embodied_active_learning.figures.visits import comparison, draw_visits
from embodied_active_learning.objects.visits import Destination, Visit

PICTURE = np.random.default_rng(0).integers(0, 255, (20, 24, 3), dtype=np.uint8)


def make_visit(prediction=PICTURE, label="unknown-1"):
    destination = Destination(label, np.array([0.4, 0.1]), np.array([0.4, 0.1, 0.0]), PICTURE[::2, ::2], None)
    return Visit(destination, destination.state, PICTURE, prediction)


@pytest.mark.parametrize("visits", [[make_visit(None)], [make_visit(label=f"{'a' * 64}/object-1/1")] * 3])
def test_figure_has_a_row_per_visit(tmp_path, recwarn, visits):
    height = cv2.imread(str(draw_visits(tmp_path / "visits.png", visits))).shape[0]
    assert height == pytest.approx(408 * len(visits), abs=2)
    assert [str(warning.message) for warning in recwarn] == []


def test_comparison_has_the_height_of_a_picture():
    shown = comparison(make_visit())
    assert shown.shape == (20, 3 * 24 + 8, 3)
    np.testing.assert_array_equal(shown[:, -24:], PICTURE)
    np.testing.assert_array_equal(shown[:, 28:52], PICTURE)


def test_missing_prediction_is_black():
    assert not comparison(make_visit(None))[:, 28:52].any()
