"""From a recording and arguments to the configuration of a session that learns from it, or only stores it."""

from __future__ import annotations

from typing import Sequence

from embodied_active_learning.config import RECORDED, Config
from embodied_active_learning.errors import BagError
from embodied_active_learning.pipeline.resolve import combine, resolve
from embodied_active_learning.ros.bags.recording import Recording


def resolve_replay(recording: Recording, profile: str, overrides: Sequence[str]) -> Config:
    """The configuration of a run on a recording: what it was recorded with, a profile, and overrides.

    A new run makes as many steps as there are observations, a resumed one as many as it was to make, unless an override
    says otherwise. Raises as resolve does, and BagError or ObservationError for a recording that cannot be learned
    from.
    """
    overrides = [*overrides, f"arm/robot={RECORDED}"]
    recorded = recording.settings()
    before = combine(profile, overrides, recorded=recorded)
    found = recording.count(before)
    steps = combine("", overrides, recorded=recorded).exploration.steps if before.session.resume else found
    config = resolve(profile, [f"exploration/steps={steps}", *overrides], recorded=recorded)
    steps = config.exploration.steps
    if steps > found:
        raise BagError(f"{recording.path} holds {found} observations, {steps} steps were asked for: ask for fewer")
    return config


def resolve_copy(recording: Recording, profile: str, overrides: Sequence[str]) -> Config:
    """The configuration of a new session that holds a recording's observations, however few. Raises as resolve does.

    BagError or ObservationError tell of a recording without observations.
    """
    overrides = [*overrides, f"arm/robot={RECORDED}"]
    recorded = recording.settings()
    before = combine(profile, overrides, recorded=recorded)
    # A session of too few for learning is like one whose run was stopped.
    steps = max(recording.count(before), before.training.first_update_at)
    return resolve(profile, [f"exploration/steps={steps}", *overrides], recorded=recorded)
