"""From a recording and arguments to the configuration of a run that learns from it."""

from __future__ import annotations

from typing import Sequence

from embodied_active_learning.config import RECORDED, Config
from embodied_active_learning.errors import BagError
from embodied_active_learning.resolve import combine, resolve
from embodied_active_learning.ros.recordings import Recording


def resolve_replay(recording: Recording, profile: str, overrides: Sequence[str]) -> Config:
    """The configuration of a new run on a recording: what it was recorded with, a profile, and overrides.

    It makes as many steps as there are observations, unless an override says fewer. Raises as resolve does, and
    BagError or ObservationError for a recording that cannot be learned from.
    """
    overrides = [*overrides, f"arm/robot={RECORDED}"]
    recorded = recording.settings()
    found = recording.count(combine(profile, overrides, recorded=recorded))
    config = resolve(profile, [f"exploration/steps={found}", *overrides], recorded=recorded)
    steps = config.exploration.steps
    if steps > found:
        raise BagError(f"{recording.path} holds {found} observations, {steps} steps were asked for: ask for fewer")
    return config
