"""The functions of the public Python API that are not classes of their own: see the package's docstring."""

from __future__ import annotations

import logging
import os
import time
from numbers import Real
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence, Union

from embodied_active_learning.config import SIMULATED, Config
from embodied_active_learning.errors import ConfigError, ObservationError, SessionError
from embodied_active_learning.files import short_repr
from embodied_active_learning.model.trained_model import TrainedModel
from embodied_active_learning.objects.collection import ViewCollection
from embodied_active_learning.objects.decision import Decision
from embodied_active_learning.objects.fingerprint import FingerprintSet
from embodied_active_learning.pipeline.fingerprinting import FingerprintRun
from embodied_active_learning.pipeline.identification import IdentificationRun
from embodied_active_learning.pipeline.resolve import resolve_config
from embodied_active_learning.schema import settings, suggestion
from embodied_active_learning.session.fingerprints import load_fingerprints
from embodied_active_learning.session.session import Session, find_session, known_sessions, session_root
from embodied_active_learning.session.session_model import load_session_model
from embodied_active_learning.simulation.simulation import Simulation
from embodied_active_learning.simulation.world import load_world

LOG = logging.getLogger(__name__)
SessionLike = Union[Session, Path, str]
"""A session, its folder, or its name below the default session/root."""
FingerprintsLike = Union[SessionLike, FingerprintSet]
"""A session with fingerprints, or what `fingerprint` returned for it."""


def load_config(profile: str = "", **overrides: Any) -> Config:
    """Return the configuration of a run, checked against world and sessions.

    Args:
        profile: Name of a profile in config/, or path of a YAML file. Without one, the defaults.
        **overrides: Keys that are unique among all sections (`world="right", steps=300`), and sections with their keys
            (`exploration={"samples": 500}`). Of a key given in both ways, the first one counts.

    Raises:
        ConfigError: Unknown or ambiguous key, or invalid value.
        WorldError: The world cannot be built.
        SessionError: The session exists, or cannot be resumed.
    """
    return resolve_config(profile, _sections(overrides))


def load_session(session: SessionLike) -> Session:
    """Open a session for reading, also while it is running. Raises SessionError if it does not exist."""
    if isinstance(session, Session):
        return session
    if not isinstance(session, (str, os.PathLike)):
        raise SessionError(f"session is {short_repr(session)}: expected a Session, its folder, or its name")
    if isinstance(session, str) and os.sep not in session:
        return Session.open_read_only(find_session(session_root(Config()), session))
    path = Path(os.path.abspath(os.path.expanduser(session)))
    if not path.is_dir():
        raise SessionError(f"there is no session {path}: {known_sessions(path.parent)}")
    return Session.open_read_only(path)


def load_model(session: SessionLike) -> Optional[TrainedModel]:
    """Return the newest model of a session; None before the first update. Raises CorruptFileError if it is damaged."""
    found = load_session_model(load_session(session))
    return None if found is None else found.model


def fingerprint(session: SessionLike, from_stored: bool = False, **settings_: Any) -> FingerprintSet:
    """Collect and store the fingerprints of all objects that a session has learned.

    Args:
        session: A session that was learned.
        from_stored: Choose the views among the stored observations instead of collecting them in the simulation.
        **settings_: Keys of the section `fingerprint`, such as `views=30`.

    Raises:
        ConfigError: Invalid setting, or the session is not of the simulation and from_stored is not set.
        SessionError: Nothing was learned yet.
        ObservationError: There is nothing to find, or too few views.
    """
    found = load_session(session)
    values = found.config.to_dict()
    values["fingerprint"].update(settings_)
    config = Config.from_dict(values, stored=True)
    if not from_stored and config.arm.robot != SIMULATED:
        raise ConfigError(
            f"arm/robot of session {found.name} is {config.arm.robot}, whose views cannot be taken in the simulation: "
            "use from_stored=True, or fingerprint.launch"
        )
    run = FingerprintRun(found.paths.path, config.fingerprint, from_stored)
    if run.clustering.low_contrast:
        raise ObservationError(run.summary)
    LOG.log(logging.WARNING if run.is_doubtful else logging.INFO, "%s", run.summary)
    if not from_stored:
        _collect_views(run, config)
    return run.finish()


def identify(
    session: Union[FingerprintsLike, Sequence[FingerprintsLike]],
    images_of: SessionLike,
    images: int = 0,
    name: str = "",
    overwrite: bool = False,
    **settings_: Any,
) -> List[Decision]:
    """Search for the fingerprints of one or several sessions in the images of another one, and store the decisions.

    Args:
        session: Session or sessions with fingerprints, or what `fingerprint` returned. Each is searched for once.
        images_of: Session with the images to search.
        images: Number of images, from the first on; 0 for all.
        name: Name of the results below identification/ in `images_of`; empty for the current time.
        overwrite: Replace earlier results of that name.
        **settings_: Keys of the section `identification`, such as `decision="belief"`.

    Raises:
        ConfigError: Invalid setting or number of images, or the cameras differ.
        SessionError: There are no fingerprints or too few images, two sessions have one name, or the name of the
            results is taken.
    """
    sets = _load_sets([session] if isinstance(session, (Session, FingerprintSet, str, os.PathLike)) else session)
    images = _whole_number("images", images)
    searched = load_session(images_of)
    values = searched.config.to_dict()
    values["identification"].update(settings_)
    section = Config.from_dict(values, stored=True).identification
    name = name or time.strftime("%Y%m%d-%H%M%S")
    with IdentificationRun(searched.paths.path, sets, name, images, section, overwrite, must_be_stored=True) as run:
        while not run.complete:
            run.advance()
        decisions = run.decide()
        run.save(decisions)
    return decisions


def _load_sets(sources: Sequence[FingerprintsLike]) -> List[FingerprintSet]:
    """Return the sets to search for, each once."""
    if not isinstance(sources, Sequence):
        raise SessionError(f"session is {short_repr(sources)}: expected sessions or sets of fingerprints")
    if not sources:
        raise SessionError("no sessions given: name at least one session with fingerprints")
    sets: Dict[Union[int, str], FingerprintSet] = {}
    for source in sources:
        if isinstance(source, FingerprintSet):
            sets[id(source)] = source
        else:
            path = load_session(source).paths.path
            sets[os.path.realpath(path)] = load_fingerprints(path)
    return list(sets.values())


def _whole_number(name: str, value: Any) -> int:
    """Return a number without its fraction, which must be 0."""
    if not isinstance(value, Real) or not float(value).is_integer():
        raise ConfigError(f"{name} is {short_repr(value)}: expected a whole number")
    return int(float(value))


def _collect_views(run: FingerprintRun, config: Config) -> None:
    """Collect the views of everything that was found in the session's simulated world."""
    world = load_world(config.simulation.world, config.workspace.box())
    with Simulation(world, config) as simulation:
        for name, collection in zip(run.names, run.collections):
            if isinstance(collection, ViewCollection):
                _fill(collection, simulation)
            run.require_complete(name)


def _fill(collection: ViewCollection, simulation: Simulation) -> None:
    simulation.go_to(collection.start.tolist())
    while True:
        collection.observe(simulation.pose, simulation.velocity, simulation.image())
        if collection.complete or collection.exhausted:
            return
        simulation.execute(collection.next_command())


def _sections(overrides: Mapping[str, Any]) -> Dict[str, Dict[str, Any]]:
    """Return keyword arguments as sections of keys; a key given by its own name precedes its section."""
    keys: Dict[str, List[str]] = {}
    for section, item in settings(Config):
        keys.setdefault(item.name, []).append(section)
    names = {section for section, _ in settings(Config)}
    sections: Dict[str, Dict[str, Any]] = {}
    for name, value in sorted(overrides.items(), key=lambda item: item[0] not in names):
        if name in names:
            if not isinstance(value, dict):
                raise ConfigError(f"section {name} is {short_repr(value)}: give a dictionary of its keys")
            added, section = value, name
        elif len(keys.get(name, ())) == 1:
            added, section = {name: value}, keys[name][0]
        elif name in keys:
            choices = " or ".join(f"{section}={{{name!r}: ...}}" for section in keys[name])
            raise ConfigError(f"{name} is a key of several sections: give {choices}")
        else:
            raise ConfigError(f"unknown key {name}: {suggestion(name, [*names, *keys])}")
        values = {key: os.fspath(one) if isinstance(one, os.PathLike) else one for key, one in added.items()}
        sections.setdefault(section, {}).update(values)
    return sections
