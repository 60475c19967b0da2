"""Imported first by nodes and scripts, before the slow imports, to end them without a traceback in two cases.

Ctrl-C during the imports ends the process at once. A missing Python module is reported in one sentence.
"""

import signal
import sys
from types import TracebackType
from typing import Optional, Type

_REMEDY = (
    "deactivate other Python environments (conda, venv) and source setup.bash again, or in a catkin workspace run "
    '/usr/bin/python3 -m pip install -r "$(rospack find embodied_active_learning)/requirements.txt"'
)


def _report_exception(kind: Type[BaseException], error: BaseException, traceback: Optional[TracebackType]) -> None:
    """Report an uncaught exception; a missing module of another package in one sentence."""
    if isinstance(error, ModuleNotFoundError) and error.name and not error.name.startswith("embodied_active_learning"):
        sys.stderr.write(f"Python module {error.name} is missing for {sys.executable}: {_REMEDY}\n")
    else:
        sys.__excepthook__(kind, error, traceback)


signal.signal(signal.SIGINT, signal.SIG_DFL)
sys.excepthook = _report_exception
