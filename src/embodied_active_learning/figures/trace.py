"""Why a fingerprint was found or not: everything that a stream of images said about it."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from embodied_active_learning.figures.style import (
    GREY,
    LARGE,
    MAP_COLOURS,
    MEDIUM,
    SMALL,
    UNSEEN,
    colour,
    label,
    new_figure,
    place,
    quiet,
    save,
    spread,
    write,
)
from embodied_active_learning.figures.views import (
    FOUND,
    Extent,
    draw_image,
    explain_marks,
    mark_decisions,
    mark_objects,
    show_extent,
)
from embodied_active_learning.geometry import Location, pose_distance
from embodied_active_learning.objects.decision import Decision
from embodied_active_learning.objects.fingerprint import BLANK, Fingerprint
from embodied_active_learning.objects.matching import Matches

NEXT_TO = 0.03
"""Distance [m] up to which an image counts as taken from next to a decision."""

_MOST_DECISIONS = 4
_SHOWN = 5  # images of a decision
_VALUES = (0.2, 0.8)  # measurements that get colours of their own: nearly all of them
_MARGIN = 0.02  # m, around everything that the map shows
_WIDTH, _LEFT = 11.6, 0.25  # inches; so are all sizes below
_DISTANCES_TOP, _MAP_TOP, _STRIPS_TOP = 1.3, 3.85, 7.95
_MAP = 2.9
_PAIR, _STRIP = (2.12, 1.04), 1.95
_GAP = 0.08  # between the images of a pair, of their width
_TITLE_WIDTH = 120  # letters


def draw_trace(
    path: Path,
    title: str,
    trace: Matches,
    states: np.ndarray,
    images: np.ndarray,
    fingerprint: Fingerprint,
    threshold: float,
    decisions: Sequence[Decision],
    objects: Sequence[Location] = (),
) -> Path:
    """Distances over time, where the images point to, which stored views won, and images from next to each decision.

    trace: what N >= 1 images (N, H, W, 3) uint8 from states (N, 3) [m, m, rad] said about the fingerprint; threshold:
    the distance at which a measurement is 1/2; decisions: this fingerprint's alone, four of them are shown; objects:
    name, x [m], y [m] of what really stands on the table.
    """
    return save(trace_figure(title, trace, states, images, fingerprint, threshold, decisions, objects), path)


def trace_figure(
    title: str,
    trace: Matches,
    states: np.ndarray,
    images: np.ndarray,
    fingerprint: Fingerprint,
    threshold: float,
    decisions: Sequence[Decision],
    objects: Sequence[Location] = (),
) -> Figure:
    """The same, not yet written."""
    explained = decisions[:_MOST_DECISIONS]
    chosen = [_next_to(decision, states) for decision in explained]
    figure = new_figure(_WIDTH, _STRIPS_TOP + _STRIP * len(explained), arranged=False)
    heading = "\n".join(textwrap.wrap(title, _TITLE_WIDTH, max_lines=2, placeholder=" ..."))
    write(figure, _LEFT, 0.2, heading, LARGE)
    draw_image(place(figure, _LEFT, _DISTANCES_TOP, 1.6, 1.6), fingerprint.thumbnail, f"sought: {fingerprint.name}")
    shown = np.concatenate([np.empty(0, int), *(near[spread(len(near), _SHOWN)] for near in chosen)])
    _draw_distances(place(figure, 2.6, _DISTANCES_TOP, _WIDTH - 2.8, 1.6), trace, threshold, shown)
    axes = place(figure, 0.75, _MAP_TOP, _MAP, _MAP)
    _draw_places(axes, place(figure, 0.85 + _MAP, _MAP_TOP, 0.12, _MAP), trace, states, decisions, objects)
    _draw_winners(place(figure, 5.2, _MAP_TOP, _WIDTH - 5.4, _MAP), trace, threshold, len(fingerprint.images))
    if explained:
        told = "New images from next to each decision, to the right of the stored view that each is most like"
        write(figure, _LEFT, _STRIPS_TOP - 0.52, told, LARGE)
    for index, (decision, near) in enumerate(zip(explained, chosen)):
        top = _STRIPS_TOP + index * _STRIP
        _draw_strip(figure, top, decision, near, trace, images, fingerprint, threshold)
    explain_marks(figure, bool(objects), 0.6)
    return figure


def _draw_distances(axes: Axes, trace: Matches, threshold: float, shown: np.ndarray) -> None:
    """Distance over image number; shown: the images that appear in the strips."""
    below = trace.distance < threshold
    numbers = np.arange(len(below))
    for part, ink in ((~below, GREY), (below, colour(0))):
        axes.scatter(numbers[part], trace.distance[part], s=4, color=ink, linewidths=0)
    axes.scatter(shown, trace.distance[shown], s=36, facecolors="none", edgecolors=FOUND, linewidths=1.0)
    axes.axhline(threshold, color="black", linestyle=(0, (4, 3)), linewidth=0.8)
    quiet(axes)
    axes.locator_params(axis="x", integer=True)
    axes.set_xlim(-0.5, len(below) - 0.5)
    axes.set_ylim(bottom=0.0)
    title = f"{below.sum()} of {len(below)} images are closer than the threshold {threshold:.2f} (dashed)"
    label(
        axes, "image" + " (ringed: shown below)" * bool(len(shown)), "distance to the most\nsimilar stored view", title
    )


def _draw_places(
    axes: Axes,
    bar: Axes,
    trace: Matches,
    states: np.ndarray,
    decisions: Sequence[Decision],
    objects: Sequence[Location],
) -> None:
    """Where the images point to, the strongest measurements on top; bar: axes for the colours."""
    extent = _extent(states, decisions, objects)
    axes.set_facecolor(UNSEEN)
    show_extent(axes, extent)
    order = np.argsort(trace.value)
    x, y = trace.pose[order, :2].T
    low, high = _VALUES
    points = axes.scatter(x, y, c=trace.value[order], s=7, cmap=MAP_COLOURS, vmin=low, vmax=high, linewidths=0)
    mark_objects(axes, objects, behind=True)
    mark_decisions(axes, decisions)
    outside = ((x < extent[0]) | (x > extent[1]) | (y < extent[2]) | (y > extent[3])).sum()
    axes.set_title("where each image places it" + f" ({outside} outside)" * bool(outside), fontsize=MEDIUM)
    scale = axes.figure.colorbar(points, cax=bar, extend="both")
    scale.set_label("measurement", fontsize=SMALL)
    bar.tick_params(labelsize=SMALL)


def _draw_winners(axes: Axes, trace: Matches, threshold: float, views: int) -> None:
    numbers = np.arange(views)
    won = np.bincount(trace.view, minlength=views)
    closely = np.bincount(trace.view[trace.distance < threshold], minlength=views)
    axes.bar(numbers, won, width=0.8, color=GREY, alpha=0.5, label="all images")
    axes.bar(numbers, closely, width=0.8, color=colour(0), label="those closer than the threshold")
    quiet(axes)
    axes.locator_params(axis="x", integer=True)
    axes.set_xlim(-0.6, views - 0.4)
    axes.legend(fontsize=SMALL, frameon=False, loc="upper left")
    axes.margins(y=0.25)
    title = f"{np.count_nonzero(won)} of {views} stored views were the most similar one to some image"
    label(axes, "stored view", "images", title)


def _draw_strip(
    figure: Figure,
    top: float,
    decision: Decision,
    near: np.ndarray,
    trace: Matches,
    images: np.ndarray,
    fingerprint: Fingerprint,
    threshold: float,
) -> None:
    """Stored and new views in pairs, of some of the images `near` (M,) a decision."""
    x, y, _ = decision.pose
    outcome = f"{decision.instance}: found" if decision.found else "Not found; it fitted best"
    sample = f"{min(_SHOWN, len(near))} of {len(near)} images" if len(near) else "No image"
    within = f"{sample} from within {100.0 * NEXT_TO:.0f} cm"
    told = f"{outcome} at x {x:.3f} m, y {y:+.3f} m: {decision.reason}. {within}."
    write(figure, _LEFT, top - 0.23, told, MEDIUM)
    for column, index in enumerate(near[spread(len(near), _SHOWN)]):
        axes = place(figure, _LEFT + column * (_PAIR[0] + 0.12), top, *_PAIR)
        distance = trace.distance[index]
        caption = f"image {index}: distance {distance:.2f}"
        if decision.kind != BLANK:
            away, _ = pose_distance(trace.pose[index], decision.pose)
            caption += f"\nplaces it {100.0 * away:.1f} cm from here"
        draw_image(axes, _pair(fingerprint.images[trace.view[index]], images[index]), caption)
        axes.xaxis.label.set_color(colour(0) if distance < threshold else GREY)


def _next_to(decision: Decision, states: np.ndarray) -> np.ndarray:
    """(M,) indices of the images from next to a decision."""
    distance, _ = pose_distance(states, decision.pose)
    return np.flatnonzero(distance < NEXT_TO)


def _pair(stored: np.ndarray, new: np.ndarray) -> np.ndarray:
    height, width = stored.shape[:2]
    return np.hstack((stored, np.full((height, max(1, round(_GAP * width)), 3), 255, np.uint8), new))


def _extent(states: np.ndarray, decisions: Sequence[Decision], objects: Sequence[Location]) -> Extent:
    """The part of the table where the camera was, decisions were made, or objects stand."""
    places = [*states[:, :2], *(decision.pose[:2] for decision in decisions), *((x, y) for _, x, y in objects)]
    (left, bottom), (right, top) = np.min(places, axis=0) - _MARGIN, np.max(places, axis=0) + _MARGIN
    return (float(left), float(right), float(bottom), float(top))
