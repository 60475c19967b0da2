"""Where worlds, models and textures lie: in the source tree, an installed package, or pybullet_data."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Iterator

import pybullet_data

from embodied_active_learning.errors import WorldError

PACKAGE = "embodied_active_learning"

_PACKAGE_SCHEME = "package://"
_PYBULLET_SCHEME = "pybullet_data://"


def worlds_folder() -> Path:
    """The folder of the shipped worlds. Raises WorldError naming the places that were searched."""
    return package_folder(PACKAGE) / "worlds"


def package_folder(package: str) -> Path:
    """Root of a catkin package: our own source tree first, then ROS_PACKAGE_PATH and CMAKE_PREFIX_PATH."""
    candidates = list(_candidates(package))
    for folder in candidates:
        if (folder / "package.xml").is_file() and (package != PACKAGE or (folder / "worlds").is_dir()):
            return folder
    searched = ", ".join(str(folder) for folder in candidates) or "ROS_PACKAGE_PATH and CMAKE_PREFIX_PATH, both empty"
    raise WorldError(f"package {package} was not found in {searched}: source the workspace that holds it")


def locate(address: str, folder: Path) -> Path:
    """The file behind a package:// or pybullet_data:// address or a path relative to the folder; it may not exist."""
    if address.startswith(_PYBULLET_SCHEME):
        return Path(pybullet_data.getDataPath()) / address[len(_PYBULLET_SCHEME) :]
    if address.startswith(_PACKAGE_SCHEME):
        package, _, path = address[len(_PACKAGE_SCHEME) :].partition("/")
        return package_folder(package) / path
    return folder / os.path.expanduser(address)


def _candidates(package: str) -> Iterator[Path]:
    if package == PACKAGE:
        yield Path(__file__).resolve().parents[3]
    for folder in _folders("ROS_PACKAGE_PATH"):
        if folder.name == package:
            yield folder
        yield folder / package
    for folder in _folders("CMAKE_PREFIX_PATH"):
        yield folder / "share" / package


def _folders(variable: str) -> Iterator[Path]:
    return (Path(entry) for entry in os.environ.get(variable, "").split(os.pathsep) if entry)
