"""The fingerprints of a session: one folder, a generation, for everything that one call of /fingerprint has found.

A set is written whole under a temporary name and renamed to the next generation's number: the rename is the commit.
Whatever kills the process or the machine, the newest generation is the old set or the new one, never half of one.
"""

from __future__ import annotations

import os
import re
import shutil
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Dict, Iterable, Iterator, List

import cv2
import numpy as np
import torch
import yaml

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CorruptFileError, SessionError
from embodied_active_learning.files import FileReader, open_plain, shown
from embodied_active_learning.naming import check_name
from embodied_active_learning.objects.fingerprint import ARRAYS, Fingerprint, FingerprintSet
from embodied_active_learning.session import array_files
from embodied_active_learning.session.atomic import is_leftover, sync_folder, write_bytes, write_text
from embodied_active_learning.session.checkpoints import load_model, save_model
from embodied_active_learning.session.description import changed_keys, read_description
from embodied_active_learning.session.lock import claim
from embodied_active_learning.session.paths import LOCK_FILE, SessionPaths, stays_inside
from embodied_active_learning.session.tensor_files import read_tensors, write_tensors

FORMAT = "embodied_active_learning/fingerprints"
VERSION = 1
SET_FILE = "set.yaml"
MODEL_FILE = "model.safetensors"
FINGERPRINT_FILE = "fingerprint.safetensors"
THUMBNAIL_FILE = "thumbnail.png"

_KIND = "fingerprint"
_SET_FACTS = ("session", "updates", "observations", "created", "names")
_FINGERPRINT_FACTS = ("name", "kind", "importance")
_GENERATION = re.compile(r"[0-9]{6,}")
_READER = FileReader(CorruptFileError, "restore it, or call /fingerprint again")
_MODEL_READER = replace(_READER, limit=array_files.READER.limit)
_FINGERPRINT_READER = replace(_READER, limit=2**30)


def save_fingerprints(session_path: Path, found: FingerprintSet) -> Path:
    """Store a set in a session's folder in place of the one before it. -> the folder of the new generation.

    The session may be training meanwhile. Raises SessionError when the set does not fit the session, when another
    process saves one at this moment, when the disk fails, when a tensor is not finite, or when a file is larger than
    load_fingerprints takes; the set of before is kept then.
    """
    session_path = Path(session_path)
    folder = SessionPaths(session_path).fingerprints
    _check_belongs(session_path, found)
    try:
        stays_inside(session_path, folder)
        folder.mkdir(exist_ok=True)
        sync_folder(session_path)
        with open_plain(folder / LOCK_FILE, "r+b") as held:
            claim(held, folder)
            return _replace_set(folder, found)
    except (OSError, SessionError) as error:
        reason = error if isinstance(error, OSError) else error.__cause__
        if not isinstance(reason, OSError):
            raise
        raise SessionError(
            f"{folder} cannot be written ({reason.strerror}): free some of the disk, or make the folder writable; the "
            "last whole set is kept"
        ) from error


def load_fingerprints(session_path: Path) -> FingerprintSet:
    """The newest set of a session, with the session's configuration; the arrays are exactly those that were saved.

    Raises SessionError when there is none yet, CorruptFileError naming the file and the field when it is damaged, was
    not written by this package, or leads out of the session's folder.
    """
    session_path = Path(session_path)
    config = read_description(SessionPaths(session_path).config)
    while True:
        generation = _newest(session_path)
        try:
            return _read_set(session_path, generation, config)
        except CorruptFileError:
            # A save may have replaced what was being read; damage stays where it is.
            if _newest(session_path) == generation:
                raise


def has_fingerprints(session_path: Path) -> bool:
    """Whether a set was ever saved in a session's folder; it is not looked into."""
    return bool(_generations(SessionPaths(session_path).fingerprints))


def _check_belongs(session_path: Path, found: FingerprintSet) -> None:
    changes = changed_keys(read_description(SessionPaths(session_path).config), found.config)
    if changes:
        raise SessionError(
            f"fingerprints do not belong to session {session_path}: {'; '.join(changes)}; take them "
            "with its own settings"
        )


def _replace_set(folder: Path, found: FingerprintSet) -> Path:
    """Write the next generation, and delete what it makes useless. Only for the one who holds the lock."""
    _remove(path for path in folder.glob("*") if is_leftover(path.name))
    before = _generations(folder)
    target = folder / f"{int(before[0].name) + 1 if before else 1:06d}"
    temporary = folder / f".{target.name}.tmp"
    try:
        _write_set(temporary, found)
        os.replace(temporary, target)
        sync_folder(folder)
    finally:
        _remove([temporary])
    _remove(before)
    return target


def _write_set(folder: Path, found: FingerprintSet) -> None:
    folder.mkdir()
    for fingerprint in found.fingerprints:
        (folder / fingerprint.name).mkdir()
        _write_fingerprint(folder / fingerprint.name, fingerprint)
    facts = {
        "session": found.session,
        "updates": found.updates,
        "observations": found.observations,
        "created": found.created,
        "names": [fingerprint.name for fingerprint in found.fingerprints],
    }
    # The model's file is checksummed: with it, a changed set.yaml does not pass for the one that was written.
    save_model(folder / MODEL_FILE, found.weights, facts)
    _refuse_large(folder / MODEL_FILE, _MODEL_READER, "choose smaller model/hidden_sizes")
    # Last, because it brings the names of all the others to the disk.
    write_text(folder / SET_FILE, yaml.safe_dump({"format": FORMAT, "version": VERSION, **facts}, sort_keys=False))
    _refuse_large(folder / SET_FILE, _READER, "keep fewer fingerprints")


def _write_fingerprint(folder: Path, fingerprint: Fingerprint) -> None:
    # torch takes neither arrays that are read-only nor those that run backwards.
    tensors = {
        field: torch.from_numpy(np.require(getattr(fingerprint, field), requirements=["C", "W"])) for field in ARRAYS
    }
    facts = {"name": fingerprint.name, "kind": fingerprint.kind, "importance": float(fingerprint.importance)}
    write_tensors(folder / FINGERPRINT_FILE, _KIND, tensors, facts)
    _refuse_large(folder / FINGERPRINT_FILE, _FINGERPRINT_READER, "keep fewer views")
    _, png = cv2.imencode(".png", np.ascontiguousarray(fingerprint.thumbnail[..., ::-1]))
    write_bytes(folder / THUMBNAIL_FILE, png.tobytes())


def _read_set(session_path: Path, generation: Path, config: Config) -> FingerprintSet:
    path, model = generation / SET_FILE, generation / MODEL_FILE
    facts = _read_set_file(session_path, path)
    _check_inside(session_path, model)
    weights, written = load_model(model, _MODEL_READER)
    _READER.expect_fields(model, written, _SET_FACTS)
    _READER.expect(path, facts, written)
    fingerprints = tuple(
        _read_fingerprint(session_path, generation / name / FINGERPRINT_FILE) for name in facts.pop("names")
    )
    with _damage_in(path):
        return FingerprintSet(config=config, weights=weights, fingerprints=fingerprints, **facts)


def _read_set_file(session_path: Path, path: Path) -> Dict[str, Any]:
    """The facts of a set, and names that are safe to make paths of; the other facts are not checked yet."""
    _check_inside(session_path, path)
    content = _READER.read_yaml(path)
    _READER.expect_fields(path, content, ("format", "version", *_SET_FACTS))
    _READER.expect(path, content, {"format": FORMAT, "version": VERSION})
    facts = {field: content[field] for field in _SET_FACTS}
    if not isinstance(facts["names"], list):
        raise _READER.refuse(f"{path}:", f"names is {shown(facts['names'])}, expected a list")
    with _damage_in(path):
        for name in facts["names"]:
            check_name(name, "one of names")
    return facts


def _read_fingerprint(session_path: Path, path: Path) -> Fingerprint:
    _check_inside(session_path, path)
    with _damage_in(path):
        tensors, facts = read_tensors(path, _KIND, _FINGERPRINT_READER)
        _READER.expect_fields(path, facts, _FINGERPRINT_FACTS)
        _READER.expect(path, facts, {"name": path.parent.name})
        _READER.expect_fields(path, tensors, ARRAYS)
        return Fingerprint(**facts, **{field: tensor.numpy() for field, tensor in tensors.items()})


def _check_inside(session_path: Path, path: Path) -> None:
    with _damage_in(path):
        stays_inside(session_path, path)


def _refuse_large(path: Path, reader: FileReader, remedy: str) -> None:
    """Refuse to keep a file that would not be read back."""
    replace(reader, error=SessionError, remedy=remedy).check(path)


@contextmanager
def _damage_in(path: Path) -> Iterator[None]:
    """Turn whatever a stored file is refused for into an error that names it."""
    try:
        yield
    except CorruptFileError:
        raise
    except (SessionError, TypeError, ValueError) as error:
        raise _READER.refuse(f"{path}:", str(error)) from error


def _generations(folder: Path) -> List[Path]:
    """What has the name of a generation, the newest first."""
    found = [path for path in folder.glob("*") if _GENERATION.fullmatch(path.name)]
    return sorted(found, key=lambda path: int(path.name), reverse=True)


def _newest(session_path: Path) -> Path:
    generations = _generations(SessionPaths(session_path).fingerprints)
    if not generations:
        raise SessionError(
            f"session {session_path} has no fingerprints yet: call /fingerprint first, with "
            f"roslaunch embodied_active_learning fingerprint.launch session:={session_path.name}"
        )
    return generations[0]


def _remove(paths: Iterable[Path]) -> None:
    """Delete files and folders, and never what a link leads to. What resists is left to the next save."""
    for path in paths:
        with suppress(OSError):
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink()
