"""Names of sessions, fingerprints and identifications: they become folder names, so only safe ones are accepted."""

from __future__ import annotations

import re

from embodied_active_learning.errors import SessionError

MAX_NAME_LENGTH = 64
_LEGAL = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")
_MAX_QUOTED = 80
"""Characters of an invalid name that an error message quotes."""


def check_name(name: str, subject: str = "session/name") -> str:
    """Return the name if it is safe as a folder name.

    Raises:
        SessionError: With the rule, if it is not.
    """
    if not isinstance(name, str) or not _LEGAL.fullmatch(name):
        raise SessionError(
            f"{subject} is {str(name)[:_MAX_QUOTED]!r}: give 1 to {MAX_NAME_LENGTH} of a-z, 0-9, '_' and '-', "
            "beginning with a letter or a digit"
        )
    return name
