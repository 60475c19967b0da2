"""A node's own account of itself on /diagnostics, once a second of wall time."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Callable, Dict

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import Updater

from embodied_active_learning.ros.node import Ticker

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


@dataclass
class Health:
    """One diagnosis: a level, a sentence and its figures."""

    level: int = OK
    message: str = ""
    values: Dict[str, object] = field(default_factory=dict)


def report_health(name: str, health: Callable[[], Health]) -> None:
    """Publish what health() answers as the diagnosis called name, every second until the node ends."""

    def fill(status):
        diagnosis = health()
        status.summary(diagnosis.level, diagnosis.message)
        for key, value in diagnosis.values.items():
            status.add(key, str(value))
        return status

    updater = Updater()
    updater.setHardwareID("none")
    updater.add(name, fill)
    Ticker(1.0, updater.force_update)
