"""Named errors of the arm to codes of its answers and back: the one place that knows which is which."""

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
    """The field cause of an answer that tells of an error; what has no code of its own was refused as asked."""
    matching = [cause for cause, error_class in _ERRORS.items() if isinstance(error, error_class)]
    return {"cause": matching[0] if matching else ArmCause.REFUSED}


def error_of(cause: int, message: str) -> CommandError:
    """The error that an answer of the arm tells of; an unknown code is a refusal."""
    return _ERRORS.get(cause, CommandError)(message)
