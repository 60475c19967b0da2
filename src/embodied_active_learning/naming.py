"""Names of sessions, fingerprints and identifications: they become folder names, so only safe ones are accepted."""

from __future__ import annotations

import re
from typing import Pattern

from embodied_active_learning.errors import SessionError

MAX_NAME_LENGTH = 64
_LEGAL = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")
_RECORDED = re.compile(r"[a-z0-9][a-z0-9_.-]{0,63}")
_MAX_QUOTED = 80
"""Characters of an invalid name that an error message quotes."""


def check_name(name: str, subject: str = "session/name") -> str:
    """Return the name if it is safe as a folder name.

    Raises:
        SessionError: With the rule, if it is not.
    """
    return _check(name, subject, _LEGAL, "'_' and '-'")


def check_recorded_name(name: str, subject: str) -> str:
    """Return a session name read from a file; older sessions may have a dot in their name. Never use it in a path.

    Raises:
        SessionError: With the rule, if the name breaks it.
    """
    return _check(name, subject, _RECORDED, "'_', '-' and '.'")


def _check(name: str, subject: str, legal: Pattern[str], signs: str) -> str:
    if not isinstance(name, str) or not legal.fullmatch(name):
        raise SessionError(
            f"{subject} is {str(name)[:_MAX_QUOTED]!r}: give 1 to {MAX_NAME_LENGTH} of a-z, 0-9, {signs}, beginning "
            "with a letter or a digit"
        )
    return name
