"""Derive the configuration of a session from a recording, for learning from it or for storing it."""

from __future__ import annotations

from typing import Any, Dict, Sequence

from embodied_active_learning.config import RECORDED, Config, merge
from embodied_active_learning.errors import BagError
from embodied_active_learning.pipeline.resolve import merge_config, resolve_config
from embodied_active_learning.ros.bags.recording import Recording
from embodied_active_learning.ros.launch_arguments import parse_overrides


def resolve_replay(recording: Recording, profile: str, overrides: Sequence[str]) -> Config:
    """Return the configuration of a learning run on a recording: recorded settings, then profile, then overrides.

    Unless overridden, a new run has as many steps as there are observations, and a resumed one keeps its number.
    Raises as resolve_config() does, and BagError or ObservationError for an unusable recording.
    """
    changes = _recorded_changes(overrides)
    recorded = recording.settings()
    preliminary = merge_config(profile, changes, recorded=recorded)
    found = recording.count(preliminary)
    resumed = preliminary.session.resume
    steps = merge_config("", changes, recorded=recorded).exploration.steps if resumed else found
    # The recording has ended already.
    defaults = {"exploration": {"steps": steps, "stop": "fixed"}}
    config = resolve_config(profile, merge(defaults, changes), recorded=recorded)
    steps = config.exploration.steps
    if steps > found:
        raise BagError(f"{recording.path} has {found} observations, {steps} steps were requested: request fewer")
    return config


def resolve_copy(recording: Recording, profile: str, overrides: Sequence[str]) -> Config:
    """Return the configuration of a new session that stores all observations of a recording, however few.

    Raises as resolve_config() does, and BagError or ObservationError for a recording without observations.
    """
    changes = _recorded_changes(overrides)
    recorded = recording.settings()
    preliminary = merge_config(profile, changes, recorded=recorded)
    # With fewer observations than the first update needs, it is stored like a run that was stopped early.
    steps = max(recording.count(preliminary), preliminary.training.first_update_at)
    return resolve_config(profile, merge({"exploration": {"steps": steps}}, changes), recorded=recorded)


def _recorded_changes(overrides: Sequence[str]) -> Dict[str, Dict[str, Any]]:
    return parse_overrides([*overrides, f"arm/robot={RECORDED}"])
