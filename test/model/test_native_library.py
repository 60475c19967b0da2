"""Loading of the compiled kernels: where they are found, and when they are refused."""

from __future__ import annotations

import ctypes
import logging
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import embodied_active_learning
from embodied_active_learning.model.native import library
from embodied_active_learning.model.native.library import FILE_NAME, load_kernels

SOURCE = Path(library.__file__).with_name("kernels.c")
needs_compiler = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc")


@pytest.fixture
def folder(monkeypatch, tmp_path):
    """The only folder in which the library is searched for; empty at first."""
    monkeypatch.setattr(library, "_folders", lambda: [tmp_path])
    load_kernels.cache_clear()
    yield tmp_path
    load_kernels.cache_clear()


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """A library compiled without optimisation and for any processor of this kind."""
    path = tmp_path_factory.mktemp("kernels") / FILE_NAME
    subprocess.run(["gcc", "-std=gnu11", "-O0", "-shared", "-fPIC", "-o", str(path), str(SOURCE)], check=True)
    return path


def test_missing_library_is_reported_once_with_remedy(folder, caplog):
    with caplog.at_level(logging.WARNING):
        first, second = load_kernels(), load_kernels()
    assert first is second
    assert first.kernels is None
    assert f"{FILE_NAME} not found in {folder}" in first.description
    assert len(caplog.records) == 1
    assert "build the package with a C compiler" in caplog.text


@needs_compiler
def test_library_is_found_next_to_the_package(folder, compiled, caplog):
    shutil.copy(str(compiled), str(folder))
    kernels, description = load_kernels()
    assert kernels is not None
    assert f"{kernels.lanes} images at a time" in description
    assert not caplog.records


def test_library_is_searched_in_every_folder_of_the_package(monkeypatch, tmp_path):
    """In the devel space, the library is in the build folder and the Python code in the sources."""
    folders = [tmp_path / "src", tmp_path / "devel"]
    for folder in folders:
        folder.mkdir()
    monkeypatch.setattr(embodied_active_learning, "__path__", list(map(str, folders)))
    assert library._folders()[:2] == folders


def test_library_is_found_from_the_sources():
    """A process that multiprocessing spawns has the sources in sys.path before the devel space."""
    sources = Path(embodied_active_learning.__path__[-1]).parent
    path = os.pathsep.join([str(sources), *sys.path])
    command = f"from {library.__name__} import load_kernels; print(load_kernels().description)"
    output = subprocess.check_output([sys.executable, "-c", command], env={**os.environ, "PYTHONPATH": path}, text=True)
    assert output.strip() == load_kernels().description


@needs_compiler
def test_library_for_another_processor_is_refused(folder, compiled, monkeypatch):
    shutil.copy(str(compiled), str(folder))
    features = ctypes.c_char_p(b"pni fast_maths ")
    monkeypatch.setattr(library.ctypes, "c_char_p", StandIn(features))
    monkeypatch.setattr(library, "_available_features", lambda: {"pni"})
    kernels, description = load_kernels()
    assert kernels is None
    assert "compiled for another processor, this one lacks fast_maths" in description


class StandIn:
    """Replaces ctypes.c_char_p: the library claims these features."""

    def __init__(self, value):
        self._value = value

    def in_dll(self, _library, _name):
        return self._value


@needs_compiler
def test_library_of_another_version_is_refused(folder, compiled, monkeypatch):
    shutil.copy(str(compiled), str(folder))
    monkeypatch.setattr(library, "INTERFACE_VERSION", library.INTERFACE_VERSION + 1)
    kernels, description = load_kernels()
    assert kernels is None
    assert "compiled from other sources" in description


@pytest.mark.parametrize("content", [b"", b"\0" * 100])
def test_damaged_library_is_refused(folder, content):
    (folder / FILE_NAME).write_bytes(content)
    kernels, description = load_kernels()
    assert kernels is None
    assert FILE_NAME in description


@needs_compiler
def test_native_build_states_the_features_it_uses(tmp_path):
    path = tmp_path / "native.so"
    command = ["gcc", "-std=gnu11", "-O0", "-march=native", "-shared", "-fPIC", "-o", str(path), str(SOURCE)]
    subprocess.run(command, check=True)
    features = ctypes.c_char_p.in_dll(ctypes.CDLL(str(path)), "cpu_features").value.decode().split()
    assert set(features) <= library._available_features()


def test_features_are_read_from_proc_cpuinfo(monkeypatch):
    text = "processor\t: 0\nmodel name\t: any\nflags\t\t: fpu avx2 fma\n\nprocessor\t: 1\nflags\t\t: fpu\n"
    monkeypatch.setattr(library.Path, "read_text", lambda *_, **__: text)
    assert library._available_features() == {"fpu", "avx2", "fma"}
