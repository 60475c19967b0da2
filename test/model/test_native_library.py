"""The compiled kernels are built and loaded whatever the machine's compiler, cache and home are like."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
import sys

import pytest

from embodied_active_learning.model.native import library
from embodied_active_learning.model.native.library import load_library

needs_compiler = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc")
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}


@pytest.fixture(autouse=True)
def cache(monkeypatch, tmp_path):
    """An empty cache, a compiler that does not take long, and a private folder that no other test has used."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(library, "FLAGS", ("-O0", "-shared", "-fPIC"))
    library.private_folder.cache_clear()
    yield tmp_path / "cache" / "embodied_active_learning"
    library.private_folder.cache_clear()


def script(path, *lines):
    path.write_text("\n".join(("#!/bin/sh", *lines, "")))
    path.chmod(0o755)
    return path


def test_a_compiler_that_fails_is_told_with_its_own_words(monkeypatch, tmp_path):
    monkeypatch.setenv("CC", str(script(tmp_path / "cc", "echo this machine is broken >&2", "exit 1")))
    library, reason = load_library()
    assert library is None
    assert "this machine is broken" in reason


@pytest.mark.parametrize("words", ["gcc 'half", "''", "/no/such/compiler -O2"])
def test_a_compiler_that_does_not_exist_is_no_compiler(monkeypatch, words):
    monkeypatch.setenv("CC", words)
    library, reason = load_library()
    assert library is None
    assert reason


@needs_compiler
def test_the_library_is_compiled_once_and_then_taken_from_the_cache(cache):
    assert load_library()[0] is not None
    (built,) = cache.iterdir()
    before = built.stat().st_mtime_ns
    assert load_library()[0] is not None
    assert built.stat().st_mtime_ns == before


@needs_compiler
def test_the_library_is_on_the_disk_before_it_has_its_name(cache, monkeypatch):
    named = []
    monkeypatch.setattr(library.os, "fsync", lambda _: named.append(list(cache.glob("*.so"))))
    assert load_library()[0] is not None
    assert named == [[]]


@needs_compiler
def test_a_damaged_library_in_the_cache_is_built_anew(cache):
    path = cache / f"kernels_{library._fingerprint(['gcc'])}.so"
    cache.mkdir(parents=True)
    path.write_bytes(b"\0" * 100)
    assert load_library()[0] is not None
    assert list(cache.iterdir()) == [path]
    assert path.stat().st_size > 1000


def no_home(error):
    def home():
        raise error

    return home


@needs_compiler
@pytest.mark.parametrize("error", [RuntimeError("no home"), KeyError("getpwuid(): uid not found: 4321")])
def test_without_a_home_the_library_is_built_for_this_process(monkeypatch, error):
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(library.Path, "home", no_home(error))
    assert load_library()[0] is not None
    assert len(list(library.private_folder().iterdir())) == 1


@needs_compiler
def test_beside_a_cache_that_cannot_be_written_the_library_is_built_for_this_process(cache):
    cache.parent.write_text("a file, in which there are no folders")
    assert load_library()[0] is not None
    assert len(list(library.private_folder().iterdir())) == 1


@needs_compiler
def test_beside_a_cache_that_is_mounted_noexec_the_library_is_built_for_this_process(cache, monkeypatch):
    load = library.ctypes.CDLL

    def refuse_below_the_cache(path):
        if path.startswith(str(cache)):
            raise OSError(errno.EPERM, "failed to map segment from shared object")
        return load(path)

    monkeypatch.setattr(library.ctypes, "CDLL", refuse_below_the_cache)
    assert load_library()[0] is not None


@needs_compiler
def test_the_private_folder_is_gone_when_its_process_is(tmp_path):
    program = """
from embodied_active_learning.model.native import library
library.FLAGS = ("-O0", "-shared", "-fPIC")
assert library.load_library()[0] is not None
print(library.private_folder())
"""
    (tmp_path / "file").touch()
    environment = {**ENVIRONMENT, "XDG_CACHE_HOME": str(tmp_path / "file"), "TMPDIR": str(tmp_path)}
    said = subprocess.run([sys.executable, "-c", program], check=True, env=environment, stdout=subprocess.PIPE)
    folder = said.stdout.decode().strip()
    assert folder.startswith(str(tmp_path / "embodied_active_learning_"))
    assert not os.path.exists(folder)


@needs_compiler
def test_a_compiler_of_several_words_is_used(cache, monkeypatch, tmp_path):
    launcher = script(tmp_path / "ccache", f'echo "$1" >> {tmp_path}/called', 'exec "$@"')
    monkeypatch.setenv("CC", f"'{launcher}' gcc")
    assert load_library()[0] is not None
    assert set((tmp_path / "called").read_text().split()) == {"gcc"}


@needs_compiler
def test_another_text_of_any_source_builds_a_library_of_its_own(cache, monkeypatch, tmp_path):
    sources = [shutil.copy(str(source), str(tmp_path)) for source in (library.SOURCE, *library.INCLUDED)]
    monkeypatch.setattr(library, "SOURCE", library.Path(sources[0]))
    monkeypatch.setattr(library, "INCLUDED", [library.Path(source) for source in sources[1:]])
    assert len(sources) == 5
    names = {library._fingerprint(["gcc"])}
    for source in sources:
        with open(source, "a") as stream:
            stream.write("/* another text */\n")
        names.add(library._fingerprint(["gcc"]))
    assert len(names) == 1 + len(sources)


@needs_compiler
def test_another_version_of_the_compiler_builds_its_own_library(cache, monkeypatch, tmp_path):
    for version in (12, 13):
        says = f'if [ "$1" = --version ]; then echo gcc {version}; else exec gcc "$@"; fi'
        monkeypatch.setenv("CC", str(script(tmp_path / "cc", says)))
        assert load_library()[0] is not None
    assert len(list(cache.iterdir())) == 2
