"""Fixtures for tests of launch files."""

import contextlib
import io
import runpy
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from launching import ROOT


class _InProcess:
    """A program of scripts/ that has run in this process; as much of subprocess.Popen as roslaunch uses."""

    def __init__(self, command):
        output, self.returncode = io.StringIO(), 0
        with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(output):
            patch.setattr(sys, "argv", command)
            patch.setattr(sys, "excepthook", sys.excepthook)  # the programs replace it
            interrupt = signal.getsignal(signal.SIGINT)
            try:
                runpy.run_path(command[0], run_name="__main__")
            except SystemExit as end:
                self.returncode = end.code
            finally:
                signal.signal(signal.SIGINT, interrupt)
        self._output = output.getvalue()

    def communicate(self):
        return self._output, None


@pytest.fixture
def commands_in_process(monkeypatch):
    """Run the commands of launch parameters in this process, without the start of Python and the slow imports."""
    popen = subprocess.Popen

    def start(command, *arguments, **options):
        program = ROOT / "scripts" / Path(command[0]).name  # roslaunch finds its copy in the build folder
        if program.is_file():
            return _InProcess([str(program), *command[1:]])
        return popen(command, *arguments, **options)

    monkeypatch.setattr(subprocess, "Popen", start)
