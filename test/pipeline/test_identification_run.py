"""When an identification evaluates its decisions."""

from hypothesis import given
from hypothesis import strategies as st

from embodied_active_learning.pipeline.identification import FIRST_EVALUATION, next_evaluation


@given(st.integers(FIRST_EVALUATION, 5000), st.integers(0, 200))
def test_next_evaluation_comes_later_with_more_open(images, open_count):
    assert next_evaluation(images, open_count) > images
    assert next_evaluation(images, open_count) >= images + open_count
    assert next_evaluation(images, open_count + 1) >= next_evaluation(images, open_count)


def test_evaluations_become_rarer():
    images, count = FIRST_EVALUATION, 0
    while images < 2000:
        images, count = next_evaluation(images, 3), count + 1
    assert count < 30
