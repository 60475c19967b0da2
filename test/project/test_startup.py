"""Nodes and scripts: help without side effects, and missing Python modules."""

import runpy
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
NODES = sorted((ROOT / "nodes").iterdir())
SCRIPTS = sorted(path for path in (ROOT / "scripts").iterdir() if path.is_file())
FAST_TO_IMPORT = ("monitor", "recorder")


def run(path, *arguments):
    command = [sys.executable, str(path), *arguments]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize("path", NODES, ids=lambda path: path.name)
def test_nodes_import_startup_first_and_use_run_node(path):
    """run_node handles --help and the exit code."""
    lines = path.read_text().splitlines()
    imports = [line for line in lines if line.startswith(("import ", "from "))]
    assert imports[0].startswith("import embodied_active_learning.ros.runtime.startup")
    assert lines[-1].startswith("    run_node(")


@pytest.mark.parametrize("path", NODES, ids=lambda path: path.name)
def test_nodes_have_at_most_150_lines(path):
    """What can be tested without a master belongs to the library."""
    assert len(path.read_text().splitlines()) <= 150


PROGRAMS = [*(ROOT / "nodes" / name for name in FAST_TO_IMPORT), *SCRIPTS]


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.name)
def test_help_prints_docstring_without_master(path, monkeypatch, capsys):
    """In this process, because a new one imports for seconds."""
    monkeypatch.setenv("ROS_MASTER_URI", "http://localhost:1")
    monkeypatch.setattr(sys, "argv", [str(path), "--help"])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(path), run_name="__main__")
    assert not ended.value.code
    first = path.read_text().split('"""')[1].splitlines()[0]
    assert "".join(first.split()) in "".join(capsys.readouterr().out.split())


def test_missing_module_is_reported_in_one_sentence(tmp_path):
    script = tmp_path / "script.py"
    script.write_text("import embodied_active_learning.ros.runtime.startup\nimport absent_module\n")
    result = run(script)
    assert result.returncode == 1
    assert result.stderr.startswith(f"Python module absent_module is missing for {sys.executable}: ")
    assert len(result.stderr.splitlines()) == 1
