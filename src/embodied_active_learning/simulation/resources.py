"""Locate worlds, models and textures: in the source tree, an installed package, or pybullet_data."""

from __future__ import annotations

import os
import re
import site
import sys
from pathlib import Path
from typing import Iterator

import pybullet_data

from embodied_active_learning.errors import WorldError

PACKAGE = "embodied_active_learning"

_PACKAGE_SCHEME = "package://"
_PYBULLET_SCHEME = "pybullet_data://"
_RANDOM_URDF = re.compile(r"random_urdfs/(\d+)")


def worlds_folder() -> Path:
    """Return the folder of the shipped worlds. Raises WorldError with the searched folders."""
    return package_folder(PACKAGE) / "worlds"


def package_folder(package: str) -> Path:
    """Return the root of a catkin package: own source tree first, then ROS_PACKAGE_PATH and CMAKE_PREFIX_PATH.

    Raises WorldError with the searched folders.
    """
    candidates = list(_candidates(package))
    for folder in candidates:
        if (folder / "package.xml").is_file() and (package != PACKAGE or (folder / "worlds").is_dir()):
            return folder
    searched = ", ".join(str(folder) for folder in candidates) or "ROS_PACKAGE_PATH and CMAKE_PREFIX_PATH, both empty"
    raise WorldError(f"package {package} not found in {searched}: source the workspace that contains it")


def locate(address: str, folder: Path) -> Path:
    """Return the path behind an address; the file may not exist.

    address: package://PACKAGE/PATH, pybullet_data://PATH, random_urdfs/000 to /999 (procedural objects in
    pybullet_data), or a path relative to the folder. Raises WorldError for an unknown package or procedural object.
    """
    random_urdf = _RANDOM_URDF.fullmatch(address)
    if random_urdf:
        if len(random_urdf[1]) != 3:
            raise WorldError(f"unknown object {address}: pybullet_data has random_urdfs/000 to /999")
        return _pybullet_data() / "random_urdfs" / random_urdf[1] / f"{random_urdf[1]}.urdf"
    if address.startswith(_PYBULLET_SCHEME):
        return _pybullet_data() / address[len(_PYBULLET_SCHEME) :]
    if address.startswith(_PACKAGE_SCHEME):
        package, _, path = address[len(_PACKAGE_SCHEME) :].partition("/")
        return package_folder(package) / path
    return folder / os.path.expanduser(address)


def _pybullet_data() -> Path:
    return Path(pybullet_data.getDataPath())


def _candidates(package: str) -> Iterator[Path]:
    if package == PACKAGE:
        yield Path(__file__).resolve().parents[3]
    for folder in _folders("ROS_PACKAGE_PATH"):
        if folder.name == package:
            yield folder
        yield folder / package
    for folder in _folders("CMAKE_PREFIX_PATH"):
        yield folder / "share" / package
    if package == PACKAGE:  # where pip installs them
        for prefix in (sys.prefix, site.getuserbase(), Path(__file__).resolve().parents[2]):
            yield Path(prefix) / "share" / package


def _folders(variable: str) -> Iterator[Path]:
    return (Path(entry) for entry in os.environ.get(variable, "").split(os.pathsep) if entry)
