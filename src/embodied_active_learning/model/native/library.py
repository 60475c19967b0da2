"""Building and loading kernels.c for the machine that this runs on."""

from __future__ import annotations

import atexit
import ctypes
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import List, Optional, Tuple

from embodied_active_learning.model.native.kernels import signatures

SOURCE = Path(__file__).with_name("kernels.c")
INCLUDED = sorted(SOURCE.parent.glob("*.h"))
FLAGS = ("-O3", "-march=native", "-ffp-contract=fast", "-shared", "-fPIC")
BUILD_SECONDS = 300  # it takes 13 to 45, more where the processor is slow or busy


def load_library() -> Tuple[Optional[ctypes.CDLL], str]:
    """The compiled kernels, or None; and in words what they are, or why there are none.

    They are compiled once for each kind of processor and compiler, and kept in the user's cache folder; where there is
    none that can be used, they are compiled for this process alone.
    """
    compiler = os.environ.get("CC", "").strip() or "gcc"
    try:
        command = shlex.split(compiler)  # "ccache gcc" is two words
        if shutil.which(command[0]) is None:
            return None, "no C compiler: install gcc for training that is about two and a half times faster"
        library = _load(command)
    except (OSError, AttributeError, ValueError, subprocess.SubprocessError) as error:
        detail = getattr(error, "stderr", None) or str(error)
        return None, f"{SOURCE.name} could not be built with {compiler}: {detail.strip()[:500]}"
    return library, f"compiled kernels, {library.lanes()} images at a time"


def cache_folder() -> Path:
    """Where the compiled kernels are kept. Raises RuntimeError or KeyError for a user without a home."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "embodied_active_learning"


@lru_cache(maxsize=None)
def private_folder() -> Path:
    """A folder of this process, removed when it exits."""
    folder = tempfile.mkdtemp(prefix="embodied_active_learning_")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


def _load(command: List[str]) -> ctypes.CDLL:
    name = f"kernels_{_fingerprint(command)}.so"
    try:
        return _load_from(cache_folder() / name, command)
    except (OSError, RuntimeError, KeyError, subprocess.CalledProcessError):
        # No home, or a cache that is not ours to write to, mounted noexec, or full, which the compiler fails of.
        return _load_from(private_folder() / name, command)


def _load_from(path: Path, command: List[str]) -> ctypes.CDLL:
    """The library at the path; it is compiled if it is not there, or if what is there cannot be loaded."""
    if path.exists():
        try:
            return _open(path)
        except (OSError, AttributeError):
            path.unlink()
    _build(path, command)
    return _open(path)


def _open(path: Path) -> ctypes.CDLL:
    library = ctypes.CDLL(str(path))
    for name, (result, arguments) in signatures().items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library


def _build(path: Path, command: List[str]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=str(path.parent)) as folder:
        built = Path(folder) / path.name
        whole = [*command, *FLAGS, "-o", str(built), str(SOURCE)]
        subprocess.run(whole, check=True, capture_output=True, text=True, timeout=BUILD_SECONDS)
        with built.open("rb") as stream:
            os.fsync(stream.fileno())  # or a power failure could leave the name without the content
        built.replace(path)


def _fingerprint(command: List[str]) -> str:
    """Of all that the compiled code depends on: a library for another processor would crash this one."""
    digest = hashlib.sha256()
    for source in (SOURCE, *INCLUDED):
        digest.update(source.read_bytes())
    parts = (*command, _version(command), *FLAGS, platform.machine(), _processor_features())
    digest.update(" ".join(parts).encode())
    return digest.hexdigest()[:16]


def _version(command: List[str]) -> str:
    """What the compiler calls itself: its first line, or nothing where it does not say."""
    said = subprocess.run(
        [*command, "--version"], check=False, capture_output=True, text=True, errors="replace", timeout=BUILD_SECONDS
    )
    return said.stdout.partition("\n")[0]


def _processor_features() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line for line in lines if line.startswith(("flags", "Features"))), platform.processor())
