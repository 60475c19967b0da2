"""Figures of fingerprints and identifications: positions of markers, and readable text."""

from __future__ import annotations

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

import sample_decisions
import sample_fingerprints
from embodied_active_learning.config import Config
from embodied_active_learning.figures.belief_maps import BeliefPanel, beliefs_figure, draw_beliefs
from embodied_active_learning.figures.fingerprint_sheet import draw_fingerprints, fingerprints_figure
from embodied_active_learning.figures.measurement_trace import NEAR_DECISION, Trace, draw_trace, trace_figure
from embodied_active_learning.figures.top_view import compose_top_view
from embodied_active_learning.objects.decision import NOT_HERE
from embodied_active_learning.objects.fingerprint import BLANK, OBJECT
from embodied_active_learning.objects.matching import Matches
from embodied_active_learning.objects.scoring import TrueObject, Truth
from embodied_active_learning.objects.unknown import UnknownObject

CONFIG = Config.from_dict({"camera": {"width": 24, "height": 20}, "model": {"latent_size": 2}})
WORKSPACE = CONFIG.workspace.box()
OBJECTS = (TrueObject("plant_of_some_size", "plant", 0.54, 0.09), TrueObject("duck_2", "duck", 0.39, -0.10))
TRUTH = Truth(OBJECTS, {("a", "object-1"): "duck"})
LONG = "a-session-with-an-extremely-long-name-" * 4


def make_images(count, seed=0):
    return np.random.default_rng(seed).integers(0, 255, (count, 20, 24, 3), dtype=np.uint8)


def make_fingerprint(views=30, **fields):
    centre = np.array([0.54, 0.09, 0.3])
    states = centre + np.random.default_rng(views).normal(0.0, (0.01, 0.01, 0.8), (views, 3))
    fields = {"centre": centre, "states": states, "images": make_images(views), **fields}
    return sample_fingerprints.make_fingerprint(views, **fields)


def make_set(fingerprints, session="a"):
    return sample_fingerprints.make_set(session=session, config=CONFIG, fingerprints=tuple(fingerprints))


def make_decision(x=0.5, y=0.1, yaw=0.5, instance=1, **fields):
    fields = {"pose": (x, y, yaw), "instance": instance, "reason": "27 of 30 views agree", **fields}
    return sample_decisions.make_decision(**fields)


def make_panel(decisions=(), peak=(7, 2), title="a, object-1"):
    x, y = np.linspace(0.3, 0.65, 12), np.linspace(-0.17, 0.17, 9)
    mean = np.full((12, 9), 0.4)
    mean[peak] = 0.52
    return BeliefPanel(title, make_images(1)[0], x, y, mean, np.full((12, 9), 0.07), decisions)


def make_stream(count, views):
    """Return states, images and measurements, half of them near (0.5, 0.1)."""
    random = np.random.default_rng(count)
    states = WORKSPACE.denormalise(random.uniform(-1.0, 1.0, (count, 3)))
    states[: (count + 1) // 2, :2] = 0.5, 0.1
    distance = random.uniform(0.1, 4.0, count).astype(np.float32)
    view = random.integers(0, views, count).astype(np.int32)
    return states, make_images(count), Matches(view, distance, 1.0 / (1.0 + distance), states + 0.01)


def assert_picture(path, recwarn):
    picture = cv2.imread(str(path))
    assert min(picture.shape[:2]) > 400
    assert picture.std() > 10.0
    assert [str(warning.message) for warning in recwarn] == []


def assert_nothing_is_cut(figure):
    FigureCanvasAgg(figure).draw()
    drawn = figure.get_tightbbox()
    width, height = figure.get_size_inches()
    assert min(drawn.x0, drawn.y0, width - drawn.x1, height - drawn.y1) >= 0.0


def markers(axes, filled, shape="o"):
    """Return the positions (x, y) of filled or hollow markers."""
    found = [
        line for line in axes.lines if line.get_marker() == shape and (line.get_markerfacecolor() != "none") == filled
    ]
    return [(line.get_xdata()[0], line.get_ydata()[0]) for line in found]


def titled(figure, text):
    """Return the axes whose title begins with a text."""
    return [axes for axes in figure.axes if any(axes.get_title(loc).startswith(text) for loc in ("left", "center"))]


@pytest.mark.parametrize(("count", "objects"), [(1, ()), (3, OBJECTS)])
def test_contact_sheet_has_row_per_fingerprint(tmp_path, recwarn, count, objects):
    kinds = [OBJECT] * (count - 1) + [BLANK]
    found = make_set([make_fingerprint(name=f"{kind}-{index}", kind=kind) for index, kind in enumerate(kinds)])
    assert_picture(draw_fingerprints(tmp_path / "new" / "sheet.png", found, objects), recwarn)
    assert len(titled(fingerprints_figure(found), "in the workspace")) == count


def test_contact_sheet_fits_long_session_name():
    assert_nothing_is_cut(fingerprints_figure(make_set([make_fingerprint()], LONG[:64]), OBJECTS))


def test_contact_sheet_of_one_view(tmp_path, recwarn):
    assert_picture(draw_fingerprints(tmp_path / "sheet.png", make_set([make_fingerprint(1)])), recwarn)


def test_contact_sheet_shows_at_most_18_views():
    for views, shown in ((1, 1), (19, 18)):
        figure = fingerprints_figure(make_set([make_fingerprint(views)]))
        assert any(axes.get_xlabel().startswith(f"{shown} of {views} views") for axes in figure.axes)


def test_contact_sheet_marks_centre_and_objects():
    fingerprint = make_fingerprint()
    figure = fingerprints_figure(make_set([fingerprint]), OBJECTS)
    (wide,), (close,) = titled(figure, "in the workspace"), titled(figure, "the dashed box")
    for axes in (wide, close):
        assert markers(axes, filled=True) == [tuple(fingerprint.centre[:2])]
        crosses = [line.get_xydata()[0].tolist() for line in axes.lines if line.get_marker() == "+"]
        assert crosses == [[item.x, item.y] for item in OBJECTS]
    (left, right), (bottom, top) = close.get_xlim(), close.get_ylim()
    x, y = fingerprint.states[:, :2].T
    assert ((x > left) & (x < right) & (y > bottom) & (y < top)).all()


@pytest.mark.parametrize(("count", "with_view"), [(0, False), (9, True)])
def test_beliefs_of_few_and_many_fingerprints(tmp_path, recwarn, count, with_view):
    states = WORKSPACE.denormalise(np.random.default_rng(0).uniform(-1.0, 1.0, (9, 3)))
    view = compose_top_view(make_images(9), states, CONFIG.camera, WORKSPACE) if with_view else None
    panels = [make_panel([make_decision()]) for _ in range(count)]
    assert_picture(draw_beliefs(tmp_path / "new" / "beliefs.png", WORKSPACE, panels, view, TRUTH), recwarn)


def test_belief_maps_do_not_overlap():
    reason = "only 4 views, 5 required"
    decisions = [make_decision(0.62, 0.14, instance=0, reason=reason)]
    panels = [make_panel(decisions, title=f"{LONG[:64]}\nobject-1")] * 9
    figure = beliefs_figure(WORKSPACE, panels, truth=TRUTH)
    assert_nothing_is_cut(figure)
    boxes = [axes.get_window_extent() for axes in figure.axes]
    assert not any(one.overlaps(other) for index, one in enumerate(boxes) for other in boxes[:index])


def test_belief_map_is_brightest_at_peak():
    panel = make_panel(peak=(7, 2))
    axes = titled(beliefs_figure(WORKSPACE, [panel]), panel.title)[0]
    pixels = axes.images[0].get_array()
    row, column = np.unravel_index(pixels.argmax(), pixels.shape)
    left, right, bottom, top = axes.images[0].get_extent()
    assert left + (column + 0.5) / pixels.shape[1] * (right - left) == pytest.approx(panel.x[7])
    assert bottom + (row + 0.5) / pixels.shape[0] * (top - bottom) == pytest.approx(panel.y[2])


def test_decisions_marked_with_number_confidence_and_yaw():
    found = [make_decision(0.40, 0.05, 0.0, 1), make_decision(0.55, -0.1, np.pi / 2, 2)]
    axes = titled(beliefs_figure(WORKSPACE, [make_panel(found)]), "a, object-1")[0]
    assert markers(axes, filled=True) == [(0.40, 0.05), (0.55, -0.1)]
    assert markers(axes, filled=False) == []
    numbers = {text.get_text(): text.xy for text in axes.texts}
    assert (numbers["1"], numbers["2"]) == ((0.40, 0.05), (0.55, -0.1))
    assert [text.get_text() for text in axes.texts].count("0.90") == 2
    ticks = [np.diff(line.get_xydata(), axis=0)[0] for line in axes.lines if len(line.get_xdata()) == 2]
    assert [np.arctan2(y, x) for x, y in ticks] == pytest.approx([0.0, np.pi / 2])


def test_rejected_candidate_is_hollow_without_number():
    figure = beliefs_figure(WORKSPACE, [make_panel([make_decision(0.40, 0.05, instance=0, reason="2 of 30")])])
    axes = titled(figure, "a, object-1")[0]
    assert (markers(axes, filled=False), markers(axes, filled=True)) == ([(0.40, 0.05)], [])
    assert [text.get_text() for text in axes.texts] == []
    notes = [text.get_text() for one in figure.axes for text in one.texts]
    assert NOT_HERE in notes
    assert any(note.startswith("2 of 30") for note in notes)


def test_blank_has_no_yaw_tick():
    axes = titled(beliefs_figure(WORKSPACE, [make_panel([make_decision(kind=BLANK)])]), "a, object-1")[0]
    assert all(len(line.get_xdata()) == 1 for line in axes.lines)


def test_flat_belief_without_decisions(tmp_path, recwarn):
    panel = make_panel(peak=(slice(None), slice(None)))
    assert_picture(draw_beliefs(tmp_path / "beliefs.png", WORKSPACE, [panel]), recwarn)


@pytest.mark.parametrize(("count", "views", "decisions"), [(1, 1, 0), (200, 30, 6)])
def test_trace_of_short_and_long_streams(tmp_path, recwarn, count, views, decisions):
    states, images, trace = make_stream(count, views)
    decided = [make_decision(0.5, 0.1 - 0.05 * number, instance=number) for number in range(decisions)]
    fingerprint = make_fingerprint(views)
    path = tmp_path / "new" / "trace.png"
    truth = Truth(OBJECTS[:decisions])
    draw_trace(path, Trace("a, object-1", trace, states, images, fingerprint, 1.0, decided, truth))
    assert_picture(path, recwarn)


def test_trace_text_is_not_cut():
    states, images, trace = make_stream(200, 30)
    decided = [make_decision(instance=0, reason="only 4 views, 5 required"), make_decision(0.4, -0.1)]
    fingerprint = make_fingerprint(30, name="object-with-a-long-name")
    assert_nothing_is_cut(trace_figure(Trace(LONG, trace, states, images, fingerprint, 1.0, decided, TRUTH)))


def test_trace_shows_small_distances_with_significant_digits():
    states, images, trace = make_stream(20, 30)
    small = replace(trace, distance=trace.distance / 1000.0)
    figure = trace_figure(Trace("a", small, states, images, make_fingerprint(30), 0.00123, [make_decision()]))
    assert titled(figure, f"{(small.distance < 0.00123).sum()} of 20 images are below the distance threshold 0.0012")
    captions = [axes.get_xlabel() for axes in figure.axes if axes.get_xlabel().startswith("image ")]
    assert not any("distance 0.00\n" in caption for caption in captions)


def test_trace_pairs_images_with_stored_views():
    states, images, trace = make_stream(200, 30)
    fingerprint = make_fingerprint(30)
    figure = trace_figure(Trace("a", trace, states, images, fingerprint, 1.0, [make_decision(0.5, 0.1)]))
    captions = {axes: re.match(r"image (\d+):", axes.get_xlabel()) for axes in figure.axes}
    pairs = [(int(caption.group(1)), axes) for axes, caption in captions.items() if caption]
    assert len(pairs) == 5
    for index, axes in pairs:
        assert np.hypot(*(states[index, :2] - (0.5, 0.1))) < NEAR_DECISION
        shown = axes.images[0].get_array()
        np.testing.assert_array_equal(shown[:, :24], fingerprint.images[trace.view[index]])
        np.testing.assert_array_equal(shown[:, -24:], images[index])


def test_trace_shows_measured_poses_and_view_counts():
    states, images, trace = make_stream(200, 30)
    figure = trace_figure(Trace("a", trace, states, images, make_fingerprint(30), 1.0, [make_decision(0.5, 0.1)]))
    (places,), (winners,) = (
        titled(figure, "measured object poses"),
        [axes for axes in figure.axes if axes.get_xlabel() == "stored view"],
    )
    points = places.collections[0]
    order = np.argsort(trace.value)
    np.testing.assert_allclose(points.get_offsets(), trace.pose[order, :2])
    np.testing.assert_allclose(points.get_array(), trace.value[order])
    assert markers(places, filled=True) == [(0.5, 0.1)]
    heights = [bar.get_height() for bar in winners.containers[0]]
    assert heights == [(trace.view == view).sum() for view in range(30)]


def test_false_claim_has_own_marker_and_outcome():
    """The decision at the plant is about a fingerprint of the duck."""
    decisions = [make_decision(0.54, 0.09, instance=1), make_decision(0.39, -0.10, instance=2)]
    figure = beliefs_figure(WORKSPACE, [make_panel(decisions)], truth=TRUTH)
    axes = titled(figure, "a, object-1")[0]
    assert markers(axes, filled=True, shape="s") == [(0.54, 0.09)]
    assert markers(axes, filled=True) == [(0.39, -0.10)]
    assert "duck_2" in [text.get_text() for text in axes.texts]
    assert "false: 1 of 2" in [text.get_text() for one in figure.axes for text in one.texts]


def test_unknown_objects_marked_in_belief_maps():
    unknown = [UnknownObject(np.array([0.6, 0.1]), 1e-3, make_images(1)[0])]
    figure = beliefs_figure(WORKSPACE, [make_panel([make_decision()])], unknown=unknown)
    assert markers(titled(figure, "a, object-1")[0], filled=False, shape="D") == [(0.6, 0.1)]
    assert "unknown object" in [text.get_text() for text in figure.legends[0].get_texts()]
    assert_nothing_is_cut(figure)


def test_belief_maps_share_colour_scale_and_bar():
    weak, strong = make_panel(), make_panel(title="a, object-2")
    strong.mean[3, 3] = 0.8
    figure = beliefs_figure(WORKSPACE, [weak, strong])
    limits = [titled(figure, title)[0].images[0].get_clim() for title in ("a, object-1", "a, object-2")]
    assert limits == [pytest.approx((0.0, 0.4))] * 2
    assert any(axes.get_xlabel().startswith("belief above") for axes in figure.axes)
