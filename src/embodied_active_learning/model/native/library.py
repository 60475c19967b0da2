"""Finds and loads the kernels that CMake has compiled."""

from __future__ import annotations

import ctypes
import logging
import os
import sys
from functools import lru_cache
from pathlib import Path
from typing import List, NamedTuple, Optional, Set

import embodied_active_learning
from embodied_active_learning.model.native.bindings import Kernels

LOG = logging.getLogger(__name__)
FILE_NAME = "libembodied_active_learning_kernels.so"
INTERFACE_VERSION = 1
"""Must equal interface_version() in kernels.c."""
_REMEDY = "training uses the plain network and is about four times slower; build the package with a C compiler (gcc)"


class LoadedKernels(NamedTuple):
    """The compiled kernels, or None with the reason why they are not used."""

    kernels: Optional[Kernels]
    description: str


@lru_cache(maxsize=None)
def load_kernels() -> LoadedKernels:
    """Load the compiled kernels. A library that cannot be used is reported once, as a warning."""
    try:
        kernels = _open(_find())
    except (OSError, ValueError, AttributeError) as error:
        LOG.warning("compiled kernels not used: %s; %s", error, _REMEDY)
        return LoadedKernels(None, f"plain network (compiled kernels not used: {error})")
    return LoadedKernels(kernels, f"compiled kernels, {kernels.lanes} images at a time")


def _find() -> Path:
    """Return the library's path: next to the package, in the sources, the devel space or the install space."""
    for folder in _folders():
        if (folder / FILE_NAME).is_file():
            return folder / FILE_NAME
    raise OSError(f"{FILE_NAME} not found in {', '.join(map(str, _folders()))}")


def _folders() -> List[Path]:
    """Return the folders that may contain the library.

    Processes that multiprocessing spawns import the package from the sources, so that its __path__ lacks the devel
    space; sys.path has it.
    """
    name = embodied_active_learning.__name__
    candidates = [*embodied_active_learning.__path__, *(os.path.join(folder, name) for folder in sys.path)]
    return [Path(folder) for folder in dict.fromkeys(candidates) if os.path.isdir(folder)]


def _open(path: Path) -> Kernels:
    library = ctypes.CDLL(str(path))
    # Only data is read before the check: any function may contain instructions that this processor lacks.
    required = ctypes.c_char_p.in_dll(library, "cpu_features").value or b""
    missing = set(required.decode().split()) - _available_features()
    if missing:
        raise ValueError(f"{path} was compiled for another processor, this one lacks {', '.join(sorted(missing))}")
    if library.interface_version() != INTERFACE_VERSION:
        raise ValueError(f"{path} was compiled from other sources than these")
    return Kernels(library)


def _available_features() -> Set[str]:
    """Return the processor's features as /proc/cpuinfo names them."""
    return set(_cpuinfo("flags", "Features").split())


def processor_name() -> str:
    """Return the processor's name; empty where /proc/cpuinfo has none."""
    return _cpuinfo("model name")


def _cpuinfo(*fields: str) -> str:
    """Return the first value of any of these fields in /proc/cpuinfo; empty without one."""
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        name, _, value = line.partition(":")
        if name.strip() in fields:
            return value.strip()
    return ""
