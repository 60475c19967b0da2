"""The specification of a sweep: a YAML file of worlds, seeds and variants, and the runs that it stands for.

    profile: default
    overrides: {exploration: {steps: 3000}}
    worlds: [bottom, right]
    seeds: [1, 2, 3]
    variants:
      ergodic: {}
      random-walk: {worlds: [right], overrides: {exploration: {explorer: random_walk}}}

The runs are all combinations. Those of the first seed come first, so that an unfinished sweep shows every variant.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Callable, Dict, Iterable, List, Mapping, Sequence, Tuple

from embodied_active_learning.config import Config, merge
from embodied_active_learning.errors import ConfigError, WorldError
from embodied_active_learning.files import FileReader
from embodied_active_learning.naming import check_name
from embodied_active_learning.pipeline.resolve import merge_config
from embodied_active_learning.schema import load, required, setting
from embodied_active_learning.simulation.world import load_world

_READER = FileReader(ConfigError, "see the sweeps in experiments/", follow=True)
_NOT_COMPARED: Mapping[str, Tuple[str, ...]] = {
    "training": ("threads", "device", "checkpoints_kept"),
    "camera": ("latency", "max_age", "allow_featureless"),
    "arm": ("commander_timeout", "retries"),
    "franka": (),
    "fingerprint": (),
    "identification": (),
}
"""Settings by section (empty: all) that do not change a simulated run, except in the last digits for another device."""


@dataclass(frozen=True)
class VariantSettings:
    """What distinguishes one variant of a sweep from the others."""

    worlds: Tuple[str, ...] = setting((), "worlds in place of those of the sweep")
    seeds: Tuple[int, ...] = setting((), "seeds in place of those of the sweep", "", 0, 2**31 - 1)
    overrides: Dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class SweepSettings:
    """The keys of a sweep file."""

    worlds: Tuple[str, ...] = required("names or files of worlds; files also relative to that of the sweep")
    seeds: Tuple[int, ...] = required("random seeds", "", low=0, high=2**31 - 1)
    variants: Dict[str, VariantSettings] = field(default_factory=lambda: {"run": VariantSettings()})
    profile: str = setting("default", "profile that all runs start from")
    overrides: Dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class SweepRun:
    """One run of a sweep.

    Attributes:
        name: Name of the run, its session and its results: variant, world and seed.
        variant: Name of the variant.
        profile: Profile of the run.
        changes: Sections of keys that override the profile, world and seed included.
    """

    name: str
    variant: str
    profile: str
    changes: Mapping[str, Dict[str, Any]]

    @cached_property
    def config(self) -> Config:
        """The run's configuration without a session. Raises ConfigError for invalid keys or values."""
        return merge_config(self.profile, self.changes)


@dataclass(frozen=True)
class Sweep:
    """A sweep's name, that of its file, and its runs in the order in which they are made."""

    name: str
    runs: Tuple[SweepRun, ...]


def load_sweep(path: Path) -> Sweep:
    """Read the file of a sweep. Raises ConfigError naming the file and the key, also for keys of the runs."""
    settings = load(SweepSettings, Path(path), _READER)
    runs: List[Tuple[int, SweepRun]] = []
    for variant, own in settings.variants.items():
        for rank, seed in enumerate(own.seeds or settings.seeds):
            for world in own.worlds or settings.worlds:
                runs.append((rank, _make_run(settings, variant, _beside(path, world), seed)))
    ordered = tuple(run for _, run in sorted(runs, key=lambda item: item[0]))
    if not ordered:
        raise ConfigError(f"{path}: no runs: give at least one world, seed and variant")
    names = [run.name for run in ordered]
    duplicate = next((name for name in names if names.count(name) > 1), "")
    if duplicate:
        raise ConfigError(f"{path}: two runs are named {duplicate}: give each world and seed once")
    for run in _first_runs(ordered, lambda run: run.variant):
        try:
            _ = run.config
        except ConfigError as error:
            raise ConfigError(f"{path}: run {run.name}: {error}") from error
    return Sweep(check_name(Path(path).stem, "name of the sweep"), ordered)


def check_worlds(sweep: Sweep) -> None:
    """Load each world once. Raises WorldError, which names the first run in the world."""
    for run in _first_runs(sweep.runs, lambda run: str(run.changes["simulation"]["world"])):
        try:
            load_world(run.config.simulation.world, run.config.workspace.box(), run.config.camera)
        except WorldError as error:
            raise WorldError(f"run {run.name}: {error}") from error


def differences(stored: Config, wanted: Config) -> List[str]:
    """Return the settings that influence a run in which two runs differ, as "section/key is 1 but was 2".

    Clustering (section fingerprint) influences a run that ends once its objects are stable, and section identification
    the plans of the active explorer.
    """
    before, after = stored.portable(), wanted.portable()
    ignored = dict(_NOT_COMPARED)
    if wanted.may_stop_early:
        ignored["fingerprint"] = ("trials",)
    if wanted.exploration.explorer == "active":
        del ignored["identification"]
    return [
        f"{section}/{key} is {after[section][key]!r} but was {value!r}"
        for section, keys in before.items()
        for key, value in keys.items()
        if value != after[section][key] and not (section in ignored and key in (ignored[section] or keys))
    ]


def _first_runs(runs: Sequence[SweepRun], key: Callable[[SweepRun], str]) -> Iterable[SweepRun]:
    """Return the first run of each key."""
    firsts: Dict[str, SweepRun] = {}
    for run in runs:
        firsts.setdefault(key(run), run)
    return firsts.values()


def _beside(path: Path, world: str) -> str:
    """Return the file of a world whose path is relative to that of the sweep; other worlds as they are."""
    file = Path(path).resolve().parent / world
    return str(file) if file.is_file() else world


def _make_run(settings: SweepSettings, variant: str, world: str, seed: int) -> SweepRun:
    changes = merge(settings.overrides, settings.variants[variant].overrides)
    changes = merge(changes, {"simulation": {"world": world}, "exploration": {"seed": seed}})
    stem = re.sub("[^a-z0-9]+", "-", Path(world).stem.lower()).strip("-")
    return SweepRun(check_name(f"{variant}-{stem}-seed{seed}", "name of a run"), variant, settings.profile, changes)
