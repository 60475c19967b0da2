"""Measurement trace: every image's measurement of one fingerprint, to check why it was found or not."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
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
    default_style,
    label,
    new_figure,
    place,
    save,
    style_axes,
    write,
)
from embodied_active_learning.figures.workspace_axes import (
    FOUND,
    Extent,
    add_marker_legend,
    draw_image,
    mark_decisions,
    mark_objects,
    show_extent,
)
from embodied_active_learning.geometry import pose_distance
from embodied_active_learning.objects.decision import Decision
from embodied_active_learning.objects.fingerprint import BLANK, Fingerprint
from embodied_active_learning.objects.matching import Matches
from embodied_active_learning.objects.scoring import NO_TRUTH, Truth
from embodied_active_learning.subsampling import spread_indices

NEAR_DECISION = 0.03
"""Distance [m] within which an image counts as taken near a decision."""

_MAX_DECISIONS = 4
_IMAGES_PER_DECISION = 5
_VALUE_LIMITS = (0.2, 0.8)
"""Limits of the colour scale of measurements; few lie outside."""
_MARGIN = 0.02
"""Border [m] around everything on the map."""
_TITLE_WIDTH = 120  # characters

# Layout in inches, from the upper left corner.
_WIDTH, _LEFT = 11.6, 0.25
_DISTANCES_TOP, _MAP_TOP, _PAIRS_TOP = 1.3, 3.85, 7.95
_DISTANCES_LEFT, _DISTANCES_HEIGHT = 2.75, 1.6
_MAP_LEFT, _MAP = 0.75, 2.9
_WINNERS_LEFT = 5.2
_PAIR_WIDTH, _PAIR_HEIGHT, _PAIR_GAP = 2.12, 1.04, 0.12  # stored and new image side by side
_ROW = 1.95  # from one decision's pairs to the next
_IMAGE_GAP = 0.08  # between the images of a pair, in image widths


@dataclass(frozen=True, eq=False)
class Trace:
    """The measurements of one fingerprint in a stream of N >= 1 images.

    Attributes:
        title: Heading of the figure.
        matches: The measurements.
        states: (N, 3) camera states [m, m, rad].
        images: (N, H, W, 3) uint8.
        fingerprint: What was searched for.
        threshold: Distance at which a measurement is 1/2.
        decisions: Decisions about this fingerprint; the first four are explained.
        truth: The true scene.
    """

    title: str
    matches: Matches
    states: np.ndarray
    images: np.ndarray
    fingerprint: Fingerprint
    threshold: float
    decisions: Sequence[Decision]
    truth: Truth = NO_TRUTH


@default_style
def draw_trace(path: Path, trace: Trace, pdf: bool = False) -> Path:
    """Draw distances over time, measured poses, most similar stored views, and images near each decision."""
    return save(trace_figure(trace), path, pdf)


def trace_figure(trace: Trace) -> Figure:
    """Return the figure of draw_trace."""
    explained = trace.decisions[:_MAX_DECISIONS]
    near = [_images_near(decision, trace.states) for decision in explained]
    shown = [indices[spread_indices(len(indices), _IMAGES_PER_DECISION)] for indices in near]
    figure = new_figure(_WIDTH, _PAIRS_TOP + _ROW * len(explained), constrained=False)
    heading = "\n".join(textwrap.wrap(trace.title, _TITLE_WIDTH, max_lines=2, placeholder=" ..."))
    write(figure, _LEFT, 0.2, heading, LARGE)
    thumbnail = place(figure, _LEFT, _DISTANCES_TOP, _DISTANCES_HEIGHT, _DISTANCES_HEIGHT)
    draw_image(thumbnail, trace.fingerprint.thumbnail, trace.fingerprint.name)
    distances = place(figure, _DISTANCES_LEFT, _DISTANCES_TOP, _WIDTH - _DISTANCES_LEFT - 0.2, _DISTANCES_HEIGHT)
    _draw_distances(distances, trace, np.concatenate([np.empty(0, int), *shown]))
    poses = place(figure, _MAP_LEFT, _MAP_TOP, _MAP, _MAP)
    _draw_poses(poses, place(figure, _MAP_LEFT + _MAP + 0.1, _MAP_TOP, 0.12, _MAP), trace)
    _draw_winners(place(figure, _WINNERS_LEFT, _MAP_TOP, _WIDTH - _WINNERS_LEFT - 0.2, _MAP), trace)
    if explained:
        caption = "New images near each decision (right) and the most similar stored view of each (left)"
        write(figure, _LEFT, _PAIRS_TOP - 0.52, caption, LARGE)
    for row, (decision, indices, chosen) in enumerate(zip(explained, near, shown)):
        top = _PAIRS_TOP + row * _ROW
        write(figure, _LEFT, top - 0.23, _explanation(decision, len(indices), len(chosen)), MEDIUM)
        _draw_pairs(figure, top, trace, decision, chosen)
    add_marker_legend(figure, bool(trace.truth.objects), 0.6)
    return figure


def _draw_distances(axes: Axes, trace: Trace, shown: np.ndarray) -> None:
    """Distance of each image to its most similar stored view; shown: indices of images that are ringed."""
    distance = trace.matches.distance
    below = distance < trace.threshold
    numbers = np.arange(len(below))
    for part, ink in ((~below, GREY), (below, colour(0))):
        axes.scatter(numbers[part], distance[part], s=4, color=ink, linewidths=0)
    axes.scatter(shown, distance[shown], s=36, facecolors="none", edgecolors=FOUND, linewidths=1.0)
    axes.axhline(trace.threshold, color="black", linestyle=(0, (4, 3)), linewidth=0.8)
    style_axes(axes)
    axes.locator_params(axis="x", integer=True)
    axes.set_xlim(-0.5, len(below) - 0.5)
    axes.set_ylim(bottom=0.0)
    title = f"{below.sum()} of {len(below)} images are below the distance threshold {trace.threshold:.2g} (dashed)"
    x_label = "image (ringed: shown below)" if len(shown) else "image"
    label(axes, x_label, "distance to the most\nsimilar stored view", title)


def _draw_poses(axes: Axes, bar: Axes, trace: Trace) -> None:
    """Measured pose of each image, strongest measurements on top; bar: axes of the colour bar."""
    extent = _extent(trace)
    axes.set_facecolor(UNSEEN)
    show_extent(axes, extent)
    order = np.argsort(trace.matches.value)
    x, y = trace.matches.pose[order, :2].T
    low, high = _VALUE_LIMITS
    values = trace.matches.value[order]
    points = axes.scatter(x, y, c=values, s=7, cmap=MAP_COLOURS, vmin=low, vmax=high, linewidths=0)
    mark_objects(axes, trace.truth.objects, behind=True)
    mark_decisions(axes, trace.decisions, trace.truth)
    outside = ((x < extent[0]) | (x > extent[1]) | (y < extent[2]) | (y > extent[3])).sum()
    axes.set_title("measured object poses" + f" ({outside} outside)" * bool(outside), fontsize=MEDIUM)
    scale = axes.figure.colorbar(points, cax=bar, extend="both")
    scale.set_label("measurement (0.5: distance at the threshold)", fontsize=SMALL)
    bar.tick_params(labelsize=SMALL)


def _draw_winners(axes: Axes, trace: Trace) -> None:
    """How often each stored view was the most similar one."""
    views = len(trace.fingerprint.images)
    numbers, matches = np.arange(views), trace.matches
    won = np.bincount(matches.view, minlength=views)
    below = np.bincount(matches.view[matches.distance < trace.threshold], minlength=views)
    axes.bar(numbers, won, width=0.8, color=GREY, alpha=0.5, label="all images")
    axes.bar(numbers, below, width=0.8, color=colour(0), label="images below the threshold")
    style_axes(axes)
    axes.locator_params(axis="x", integer=True)
    axes.set_xlim(-0.6, views - 0.4)
    axes.legend(fontsize=SMALL, frameon=False, loc="upper left")
    axes.margins(y=0.25)
    title = f"{np.count_nonzero(won)} of {views} stored views were the most similar one to some image"
    label(axes, "stored view", "images", title)


def _draw_pairs(figure: Figure, top: float, trace: Trace, decision: Decision, chosen: np.ndarray) -> None:
    """Stored view and new image side by side, for some images near a decision."""
    matches = trace.matches
    for column, index in enumerate(chosen):
        axes = place(figure, _LEFT + column * (_PAIR_WIDTH + _PAIR_GAP), top, _PAIR_WIDTH, _PAIR_HEIGHT)
        distance = matches.distance[index]
        caption = f"image {index}: distance {distance:.2g}"
        if decision.kind != BLANK:
            error, _ = pose_distance(matches.pose[index], decision.pose)
            caption += f"\nmeasured {100.0 * error:.1f} cm from here"
        draw_image(axes, _side_by_side(trace.fingerprint.images[matches.view[index]], trace.images[index]), caption)
        axes.xaxis.label.set_color(colour(0) if distance < trace.threshold else GREY)


def _explanation(decision: Decision, near: int, shown: int) -> str:
    """One line about a decision and its images."""
    x, y, _ = decision.pose
    outcome = f"{decision.instance}: found" if decision.found else "Not found; best candidate"
    images = f"{shown} of {near} images" if near else "No image"
    within = f"{images} from within {100.0 * NEAR_DECISION:.0f} cm"
    return f"{outcome} at x {x:.3f} m, y {y:+.3f} m: {decision.reason}. {within}."


def _images_near(decision: Decision, states: np.ndarray) -> np.ndarray:
    """Indices (M,) of the images taken near a decision."""
    distance, _ = pose_distance(states, decision.pose)
    return np.flatnonzero(distance < NEAR_DECISION)


def _side_by_side(stored: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Join two images (H, W, 3) with a white gap."""
    height, width = stored.shape[:2]
    return np.hstack((stored, np.full((height, max(1, round(_IMAGE_GAP * width)), 3), 255, np.uint8), new))


def _extent(trace: Trace) -> Extent:
    """Part of the table with all camera positions, decisions and true objects."""
    decided = (decision.pose[:2] for decision in trace.decisions)
    places = [*trace.states[:, :2], *decided, *((item.x, item.y) for item in trace.truth.objects)]
    (left, bottom), (right, top) = np.min(places, axis=0) - _MARGIN, np.max(places, axis=0) + _MARGIN
    return (float(left), float(right), float(bottom), float(top))
