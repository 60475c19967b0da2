"""Collection of views with an ideal arm."""

from __future__ import annotations

import functools
import itertools

import numpy as np
import pytest

import embodied_active_learning as eal
from embodied_active_learning.config import Config
from embodied_active_learning.geometry import pose_distance
from embodied_active_learning.objects.collection import ViewCollection

CENTRE = (0.47, 0.01, 0.3)
CORNERS = tuple(itertools.product((0.325, 0.625), (-0.15, 0.15), (0.0,)))


CONFIG = Config()


def configuration(samples=300, **fingerprint):
    """Return a configuration for fast tests: fewer views and fewer samples of the target."""
    values = {"exploration": {"samples": samples}, "fingerprint": {"views": 20, "steps_per_view": 3, **fingerprint}}
    return Config.from_dict(values)


FAST = configuration()
WORKSPACE = CONFIG.workspace.box()


class Arm:
    """Follows each velocity exactly; the value of its images is the number of the step."""

    def __init__(self, collection, moves=True):
        self.collection, self.moves = collection, moves
        self.state, self.velocity = collection.start.copy(), np.zeros(3)
        self.path, self.commands, self.kept = [self.state], [], []

    @property
    def image(self):
        return np.full((2, 3, 3), len(self.path), np.uint8)

    def observe(self):
        self.kept.append(self.collection.observe(self.state, self.velocity, self.image))

    def step(self):
        command = self.collection.next_command()
        self.commands.append(command)
        if self.moves:
            self.velocity = command.velocity
            self.state = self.state + command.velocity * command.duration
        self.path.append(self.state)

    def run(self, steps=100000):
        for _ in range(steps):
            self.observe()
            if self.collection.complete or self.collection.exhausted:
                break
            self.step()
        return self


@functools.lru_cache(maxsize=None)
def collect(centre=CENTRE, seed=0, config=FAST):
    """Return the arm after a complete collection."""
    return Arm(ViewCollection(config, np.array(centre), seed)).run()


def box_around(centre, size=CONFIG.fingerprint.view_box):
    """Return the limits (2, 3) of the view box around a centre."""
    low, high = np.array(WORKSPACE.lower), np.array(WORKSPACE.upper)
    low[:2] = np.maximum(low[:2], np.array(centre[:2]) - size)
    high[:2] = np.minimum(high[:2], np.array(centre[:2]) + size)
    return np.stack([low, high])


THOROUGH = [(CENTRE, 0, CONFIG), (CORNERS[0], 1, CONFIG), ((0.60, -0.05, -1.9), 2, CONFIG)]
CASES = [*THOROUGH, (CENTRE, 3, FAST), *((corner, 4, FAST) for corner in CORNERS[1:])]
each_case = pytest.mark.parametrize(("centre", "seed", "config"), CASES)


@each_case
def test_collection_keeps_requested_view_count(centre, seed, config):
    collection = collect(centre, seed, config).collection
    assert collection.complete
    assert not collection.exhausted
    assert collection.states.shape == (config.fingerprint.views, 3)
    assert collection.images.shape == (config.fingerprint.views, 2, 3, 3)


@each_case
def test_collection_has_no_duplicate_views(centre, seed, config):
    states = collect(centre, seed, config).collection.states
    distance, turn = pose_distance(states[:, None], states)
    near = (distance < CONFIG.fingerprint.min_view_distance) & (turn < CONFIG.fingerprint.min_view_turn)
    np.testing.assert_array_equal(near, np.eye(len(states), dtype=bool))


@each_case
def test_commands_stay_in_view_box_and_speed_limits(centre, seed, config):
    arm = collect(centre, seed, config)
    low, high = box_around(centre)
    path = np.array(arm.path)
    assert np.all((path >= low - 1e-9) & (path <= high + 1e-9))
    speeds = np.abs([command.velocity for command in arm.commands])
    assert speeds.shape == (len(arm.path) - 1, 3)
    assert np.all(speeds[:, :2] <= CONFIG.arm.max_speed + 1e-12)
    assert np.all(speeds[:, 2] <= CONFIG.arm.max_turn_rate + 1e-12)
    assert {command.duration for command in arm.commands} == {CONFIG.exploration.step_duration}


@pytest.mark.parametrize(("centre", "seed", "config"), THOROUGH)
def test_views_match_view_std_and_cover_yaw(centre, seed, config):
    states = collect(centre, seed, config).collection.states
    for axis in range(2):
        room = np.abs(box_around(centre)[:, axis] - centre[axis])
        if room.min() == pytest.approx(CONFIG.fingerprint.view_box):
            spread = np.sqrt(np.mean(np.square(states[:, axis] - centre[axis])))
            assert 0.6 < spread / CONFIG.fingerprint.view_std < 1.6
        else:
            assert np.mean(np.abs(states[:, axis] - centre[axis])) < 2.0 * CONFIG.fingerprint.view_std
    counts, _ = np.histogram(states[:, 2], bins=4, range=(-2.0, 2.0))
    assert counts.sum() == len(states)
    assert counts.min() > 0


def test_view_std_sets_spread():
    spreads = []
    for view_std in (0.01, 0.03):
        config = configuration(samples=1000, view_std=view_std)
        spreads.append(np.std(collect(config=config).collection.states[:, :2], axis=0))
    assert np.all(spreads[1] > 1.4 * spreads[0])


def test_view_yaw_std_sets_yaw_spread():
    config = configuration(view_yaw_std=0.3)
    wide, narrow = (np.std(collect(config=item).collection.states[:, 2]) for item in (FAST, config))
    assert narrow < 0.6 * wide


def test_collection_starts_at_centre_clipped_to_workspace():
    np.testing.assert_array_equal(ViewCollection(CONFIG, np.array(CENTRE), 0).start, CENTRE)
    beyond = ViewCollection(CONFIG, np.array([0.635, 0.16, -3.0]), 0)
    np.testing.assert_allclose(beyond.start, [0.625, 0.15, -2.0])


def test_object_beyond_border_is_viewed_from_workspace():
    arm = collect((0.635, 0.0, 0.0))
    assert arm.collection.complete
    assert np.all(WORKSPACE.contains(np.array(arm.path), 1e-9))
    assert np.abs(arm.collection.states[:, 1]).mean() < 2.0 * CONFIG.fingerprint.view_std


def test_view_box_is_clipped_to_workspace():
    arm = collect(config=configuration(views=12, view_box=0.5, view_std=0.2))
    assert arm.collection.complete
    assert np.all(WORKSPACE.contains(np.array(arm.path), 1e-9))
    speeds = np.abs([command.velocity for command in arm.commands])
    assert speeds[:, :2].max() <= CONFIG.arm.max_speed + 1e-12


def test_views_taken_every_steps_per_view():
    arm = collect()
    kept = np.flatnonzero(arm.kept)
    assert np.all(kept % 3 == 0)
    np.testing.assert_array_equal(arm.collection.states, np.array(arm.path)[kept])
    np.testing.assert_array_equal(arm.collection.images[:, 0, 0, 0], kept + 1)
    often = collect(config=configuration(views=6, steps_per_view=1))
    assert np.any(np.flatnonzero(often.kept) % 3)


def test_kept_views_are_copies():
    collection = ViewCollection(CONFIG, np.array(CENTRE), 0)
    state, image = np.array(CENTRE), np.zeros((2, 3, 3), np.uint8)
    assert collection.observe(state, np.zeros(3), image)
    state += 1.0
    image += 1
    np.testing.assert_array_equal(collection.states, [CENTRE])
    assert collection.images.max() == 0


def test_new_collection_is_empty():
    collection = ViewCollection(CONFIG, np.array(CENTRE), 0)
    assert collection.states.shape == (0, 3)
    assert len(collection.images) == 0
    assert not collection.complete
    assert not collection.exhausted


def test_duplicate_needs_small_distance_and_turn():
    config = configuration(steps_per_view=1, min_view_distance=0.002, min_view_turn=0.05)
    collection = ViewCollection(config, np.array(CENTRE), 0)
    offsets = [(0, 0, 0), (0.001, 0, 0.03), (0.003, 0, 0), (0, 0.001, 0.06), (0.001, 0.001, -0.04), (0, 0.003, 0.06)]
    kept = [
        collection.observe(np.add(CENTRE, offset), np.zeros(3), np.zeros((2, 3, 3), np.uint8)) for offset in offsets
    ]
    assert kept == [True, False, True, True, False, True]


def test_collection_of_immobile_arm_is_exhausted():
    config = configuration(views=4)
    arm = Arm(ViewCollection(config, np.array(CENTRE), 0), moves=False).run(1000)
    assert arm.collection.exhausted
    assert not arm.collection.complete
    assert len(arm.collection.states) == 1
    assert 4 * 3 <= len(arm.kept) < 100


def test_commands_are_deterministic_per_seed():
    config = configuration(views=4)
    runs = [Arm(ViewCollection(config, np.array(CENTRE), seed)).run().commands for seed in (5, 5, 6)]
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


def test_interrupt_restarts_from_rest():
    arm = Arm(ViewCollection(FAST, np.array(CENTRE), 0))
    slower = FAST.fingerprint.view_box / WORKSPACE.scale[0]
    top_speed = np.array([slower * FAST.arm.max_speed] * 2 + [FAST.arm.max_turn_rate])
    unit = top_speed / FAST.planner.velocity_limits
    while np.abs(arm.velocity / unit).max() < 0.6:
        arm.observe()
        arm.step()
    arm.velocity = np.zeros(3)
    arm.collection.interrupt()
    arm.observe()
    arm.step()
    speed = np.abs(arm.velocity / unit)
    # The velocity after one step from rest is at most acceleration x step, its mean over the step half of that.
    assert speed.max() <= 0.5 * FAST.planner.acceleration_limit * FAST.exploration.step_duration + 1e-9


def test_collection_completes_after_interrupt():
    arm = Arm(ViewCollection(configuration(views=6), np.array(CENTRE), 0)).run(8)
    arm.velocity = np.zeros(3)
    arm.collection.interrupt()
    arm.run()
    assert arm.collection.complete
    assert np.all(WORKSPACE.contains(np.array(arm.path), 1e-9))


def test_views_of_paper_profile_are_complete_near_border():
    """Its planner alone can stay in a corner of the view box."""
    config = eal.load_config("paper")
    assert not config.planner.normalise_kernels
    collection = ViewCollection(config, np.array((0.533, -0.091, 0.03)), seed=1)
    assert len(Arm(collection).run().path) < 2 * config.fingerprint.views * config.fingerprint.steps_per_view
    assert collection.complete
