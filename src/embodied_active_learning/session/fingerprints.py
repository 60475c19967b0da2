"""The fingerprints of a session: one numbered folder (generation) per call of /fingerprint.

A set is written completely under a temporary name and committed by renaming it to the number of the next generation.
Whatever kills the process or the machine, the newest generation is complete.
"""

from __future__ import annotations

import logging
import os
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Collection, Dict, Iterator, Optional, Tuple

import cv2
import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CorruptFileError, SessionError
from embodied_active_learning.files import FileReader, open_regular_file, short_repr
from embodied_active_learning.naming import check_name
from embodied_active_learning.objects.fingerprint import ARRAYS, Fingerprint, FingerprintSet
from embodied_active_learning.objects.limits import CALIBRATION_VERSION, Calibration
from embodied_active_learning.schema import build, required, to_plain
from embodied_active_learning.session.array_files import READER as ARRAY_READER
from embodied_active_learning.session.array_files import read_arrays, write_arrays
from embodied_active_learning.session.atomic import (
    disk_failure_named,
    is_leftover,
    remove_paths,
    replace_folder,
    sync_folder,
    write_bytes,
)
from embodied_active_learning.session.checksummed_yaml import read_checksummed, write_checksummed
from embodied_active_learning.session.fingerprint_sets import generations, newest_generation
from embodied_active_learning.session.lock import claim
from embodied_active_learning.session.paths import LOCK_FILE, SessionPaths, stays_inside
from embodied_active_learning.session.stored_config import changed_keys, read_stored_config
from embodied_active_learning.session.summary import readable_summary
from embodied_active_learning.session.tensor_files import read_tensors, write_tensors

LOG = logging.getLogger(__name__)
FORMAT = "embodied_active_learning/fingerprints"
VERSION = 2
SET_FILE = "set.yaml"
MODEL_FILE = "model.safetensors"
FINGERPRINT_FILE = "fingerprint.safetensors"
THUMBNAIL_FILE = "thumbnail.png"
CALIBRATION_FILE = "calibration.safetensors"

_KIND, _CALIBRATION_KIND, _MODEL_KIND = "fingerprint", "calibration", "fingerprint_model"
_SIMILARITIES = ("true", "false")
_READER = FileReader(CorruptFileError, "restore it, or fingerprint the session again")
_MODEL_READER = replace(_READER, limit=ARRAY_READER.limit)
_FINGERPRINT_READER = replace(_READER, limit=2**30)


@dataclass(frozen=True)
class _SetFile:
    """The fields of set.yaml."""

    format: str = required("kind of the file")
    version: int = required("version of the format")
    session: str = required("session that was learned")
    updates: int = required("updates of the model")
    observations: int = required("observations of the session")
    created: str = required("UTC time")
    names: Tuple[str, ...] = required("names of the fingerprints")


@dataclass(frozen=True)
class _FingerprintFacts:
    """Facts of a fingerprint file."""

    name: str = required("name of the fingerprint")
    kind: str = required("object or blank")
    importance: float = required("share of the importance samples")


@dataclass(frozen=True)
class _CalibrationFacts:
    """Facts of a calibration file."""

    rules: int = required("version of the similarity and of its calibration")


def save_fingerprints(session_path: Path, found: FingerprintSet) -> Path:
    """Store a set in place of the previous one. The session may be training meanwhile.

    Returns:
        The folder of the new generation.

    Raises:
        SessionError: The set does not belong to the session, another process is saving one, the disk failed, a tensor
            is not finite, or a file is too large to be read back. The previous set is kept, unless the message says
            that the new one was written.
    """
    session_path = Path(session_path)
    folder = SessionPaths(session_path).fingerprints
    _check_belongs(session_path, found)
    with disk_failure_named(folder, "the previous set is kept"):
        stays_inside(session_path, folder)
        folder.mkdir(exist_ok=True)
        sync_folder(session_path)
        held = open_regular_file(folder / LOCK_FILE, "r+b")
    with held:
        claim(held, folder)
        return _replace_set(folder, found)


def load_fingerprints(session_path: Path) -> FingerprintSet:
    """Read the newest set of a session, with the session's configuration; warn if the model has learned more since.

    Raises:
        SessionError: The session has no fingerprints yet, or a link leads out of it.
        CorruptFileError: The set is damaged; names the file and the field.
    """
    session_path = Path(session_path)
    config = read_stored_config(SessionPaths(session_path).config)
    while True:
        generation = newest_generation(session_path)
        try:
            found = _read_set(session_path, generation, config)
            _warn_if_outdated(session_path, found)
            return found
        except CorruptFileError:
            # A new set may have replaced the one that was being read.
            if newest_generation(session_path) == generation:
                raise


def _warn_if_outdated(session_path: Path, found: FingerprintSet) -> None:
    summary = readable_summary(SessionPaths(session_path).summary)
    if summary is not None and summary.updates > found.updates:
        LOG.warning(
            "the fingerprints of session %s are those after %d of %d updates: make them again with fingerprint.launch "
            "session:=%s",
            session_path.name, found.updates, summary.updates, session_path.name,
        )  # fmt: skip


def has_fingerprints(session_path: Path) -> bool:
    """Return whether a session has a set, which may be damaged."""
    return bool(generations(session_path))


def _check_belongs(session_path: Path, found: FingerprintSet) -> None:
    changes = changed_keys(read_stored_config(SessionPaths(session_path).config), found.config)
    if changes:
        raise SessionError(
            f"fingerprints do not belong to session {session_path}: {'; '.join(changes)}; collect "
            "them with its own settings"
        )


def _replace_set(folder: Path, found: FingerprintSet) -> Path:
    """Write the next generation and delete the previous ones. The caller holds the lock."""
    remove_paths(path for path in folder.glob("*") if is_leftover(path.name))
    before = generations(folder.parent)
    target = folder / f"{int(before[0].name) + 1 if before else 1:06d}"
    with replace_folder(target) as temporary:
        _write_set(temporary, found)
    remove_paths(before)
    return target


def _write_set(folder: Path, found: FingerprintSet) -> None:
    for fingerprint in found.fingerprints:
        (folder / fingerprint.name).mkdir()
        _write_fingerprint(folder / fingerprint.name, fingerprint)
    write_tensors(folder / MODEL_FILE, _MODEL_KIND, found.weights, {})
    _refuse_large(folder / MODEL_FILE, _MODEL_READER, "choose smaller model/hidden_sizes")
    names = tuple(fingerprint.name for fingerprint in found.fingerprints)
    content = _SetFile(FORMAT, VERSION, found.session, found.updates, found.observations, found.created, names)
    # Last, because it flushes the names of all the others to the disk.
    write_checksummed(folder / SET_FILE, to_plain(content))
    _refuse_large(folder / SET_FILE, _READER, "keep fewer fingerprints")


def _write_fingerprint(folder: Path, fingerprint: Fingerprint) -> None:
    arrays = {field: getattr(fingerprint, field) for field in ARRAYS}
    facts = {"name": fingerprint.name, "kind": fingerprint.kind, "importance": float(fingerprint.importance)}
    write_arrays(folder / FINGERPRINT_FILE, _KIND, arrays, facts)
    _refuse_large(folder / FINGERPRINT_FILE, _FINGERPRINT_READER, "keep fewer views")
    if fingerprint.calibration is not None:
        similarities = {name: getattr(fingerprint.calibration, name) for name in _SIMILARITIES}
        write_arrays(folder / CALIBRATION_FILE, _CALIBRATION_KIND, similarities, {"rules": CALIBRATION_VERSION})
    _, png = cv2.imencode(".png", np.ascontiguousarray(fingerprint.thumbnail[..., ::-1]))
    write_bytes(folder / THUMBNAIL_FILE, png.tobytes())


def _read_set(session_path: Path, generation: Path, config: Config) -> FingerprintSet:
    path = stays_inside(session_path, generation) / SET_FILE
    stored = _read_set_file(path)
    weights, _ = read_tensors(generation / MODEL_FILE, _MODEL_KIND, _MODEL_READER)
    folders = [stays_inside(session_path, generation / name) for name in stored.names]
    fingerprints = tuple(map(_read_fingerprint, folders))
    with _damage_in(path):
        return FingerprintSet(
            session=stored.session,
            updates=stored.updates,
            observations=stored.observations,
            created=stored.created,
            config=config,
            weights=weights,
            fingerprints=fingerprints,
        )


def _read_set_file(path: Path) -> _SetFile:
    """Return the content of a set.yaml, with names that are safe in paths."""
    content = read_checksummed(path, _READER, FORMAT, VERSION)
    found = build(_SetFile, content, path, CorruptFileError, _READER.remedy)
    with _damage_in(path):
        for name in found.names:
            check_name(name, "one of names")
    return found


def _read_fingerprint(folder: Path) -> Fingerprint:
    path = folder / FINGERPRINT_FILE
    with _damage_in(path):
        arrays, stored = read_arrays(path, _KIND, _FINGERPRINT_READER)
        facts = build(_FingerprintFacts, stored, path, CorruptFileError, _READER.remedy)
        _READER.expect(path, stored, {"name": folder.name})
        _check_names(path, arrays)
        calibration = _read_calibration(folder / CALIBRATION_FILE)
        fields: Dict[str, Any] = {**to_plain(facts), **arrays}
        return Fingerprint(**fields, calibration=calibration)


def _read_calibration(path: Path) -> Optional[Calibration]:
    """Return the stored calibration; None without a file, or if it is of other rules."""
    if not os.path.lexists(path):
        return None
    with _damage_in(path):
        similarities, facts = read_arrays(path, _CALIBRATION_KIND, _READER)
        if build(_CalibrationFacts, facts, path, CorruptFileError, _READER.remedy).rules != CALIBRATION_VERSION:
            return None
        if sorted(similarities) != sorted(_SIMILARITIES):
            raise _READER.make_error(f"{path}:", f"expected the arrays {' and '.join(_SIMILARITIES)}")
        return Calibration(**similarities)


def _check_names(path: Path, names: Collection[str]) -> None:
    """Check that the names are exactly the arrays of a fingerprint."""
    for name in ARRAYS:
        if name not in names:
            raise _READER.make_error(f"{path}:", f"{name} is missing")
    for name in names:
        if name not in ARRAYS:
            raise _READER.make_error(f"{path}:", f"array {short_repr(name)} is unknown")


def _refuse_large(path: Path, reader: FileReader, remedy: str) -> None:
    """Check that a file is small enough to be read back."""
    replace(reader, error=SessionError, remedy=remedy).check(path)


@contextmanager
def _damage_in(path: Path) -> Iterator[None]:
    """Turn errors about the content of a file into a CorruptFileError that names it."""
    try:
        yield
    except CorruptFileError:
        raise
    except (SessionError, TypeError, ValueError) as error:
        raise _READER.make_error(f"{path}:", str(error)) from error
