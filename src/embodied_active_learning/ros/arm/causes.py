"""Conversion between the arm's named errors and the field `cause` of its responses."""

from __future__ import annotations

from typing import Dict

from embodied_active_learning.errors import (
    ArmBusyError,
    ArmFailedError,
    ArmStoppedError,
    CommandError,
    EmbodiedActiveLearningError,
)
from embodied_active_learning.msg import ArmCause

_ERRORS = {ArmCause.FAILED: ArmFailedError, ArmCause.STOPPED: ArmStoppedError, ArmCause.BUSY: ArmBusyError}


def cause_fields(error: EmbodiedActiveLearningError) -> Dict[str, int]:
    """Return the response field `cause` for an error; REFUSED if the error has no code of its own."""
    matching = [cause for cause, error_class in _ERRORS.items() if isinstance(error, error_class)]
    return {"cause": matching[0] if matching else ArmCause.REFUSED}


def error_of(cause: int, message: str) -> CommandError:
    """Return the error for a response's cause and message; CommandError for an unknown cause."""
    return _ERRORS.get(cause, CommandError)(message)
