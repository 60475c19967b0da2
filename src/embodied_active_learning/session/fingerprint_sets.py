"""Sessions that have fingerprints. Imports nothing slow: launch files check names with it before any node starts."""

from __future__ import annotations

import re
from pathlib import Path
from typing import List, Sequence

from embodied_active_learning.errors import SessionError
from embodied_active_learning.session.paths import SessionPaths
from embodied_active_learning.session.session import find_session

MAX_SESSIONS = 64
"""Largest number of sessions whose fingerprints are searched for; each keeps a model in memory."""
_GENERATION = re.compile(r"[0-9]{6,}")


def generations(session_path: Path) -> List[Path]:
    """Return the folders of a session's sets of fingerprints, the newest first."""
    found = [path for path in SessionPaths(session_path).fingerprints.glob("*") if _GENERATION.fullmatch(path.name)]
    return sorted(found, key=lambda path: int(path.name), reverse=True)


def newest_generation(session_path: Path) -> Path:
    """Return the folder of a session's newest set. Raises SessionError if it has no fingerprints."""
    found = generations(session_path)
    if not found:
        raise SessionError(
            f"session {session_path} has no fingerprints yet: make them with roslaunch embodied_active_learning "
            f"fingerprint.launch session:={session_path.name}, or in Python with fingerprint()"
        )
    return found[0]


def searched_sessions(root: Path, names: Sequence[str]) -> List[Path]:
    """Return the folders of sessions whose fingerprints are searched for; each name counts once.

    Args:
        root: Folder of all sessions.
        names: Names of the sessions.

    Raises:
        SessionError: A name is invalid or unknown, a session has no fingerprints, or there are no names or too many.
    """
    unique = list(dict.fromkeys(names))
    if not unique:
        raise SessionError("no sessions given: name at least one session with fingerprints, such as sessions:=NAME")
    if len(unique) > MAX_SESSIONS:
        raise SessionError(f"too many sessions: {len(unique)} given, at most {MAX_SESSIONS} allowed")
    paths = [find_session(root, name, "one of sessions") for name in unique]
    for path in paths:
        newest_generation(path)
    return paths
