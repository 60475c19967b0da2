#!/usr/bin/env python3
"""Makes Python modules of franka_definitions.py, for machines where franka_ros is not installed.

python3 test/fake_franka/generate.py [FOLDER]    then put FOLDER, build/franka_messages, at the end of PYTHONPATH

A package that is installed is never generated again, and so never hidden. What is there already and up to date stays as
it is, so that several launches may ask for one folder at once.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Dict, List

import genpy.generate_initpy
import genpy.generator

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from fake_franka.franka_definitions import SERVICES, message_definitions

DEFAULT_FOLDER = Path(__file__).resolve().parents[2] / "build" / "franka_messages"
"""Where the stand-in and the tests keep the modules."""
PACKAGES = tuple(sorted(SERVICES))
_STAMP = ".version"
_DEPENDENCIES = ("std_msgs", "actionlib_msgs")


def missing_packages(folder: Path) -> List[str]:
    """The packages that cannot be imported from anywhere but folder."""
    return [name for name in PACKAGES if not _is_installed(name, folder)]


def generate(folder: Path) -> List[str]:
    """See to it that folder has the modules of every package that is not installed -> their names.

    Raises RuntimeError when genpy refuses a definition or the definitions of a dependency are not installed.
    """
    names = missing_packages(folder)
    for name in names:
        _generate_package(name, folder)
    return names


def use_messages() -> None:
    """Make the packages importable in this process, from where they are installed or else from DEFAULT_FOLDER."""
    generate(DEFAULT_FOLDER)
    if str(DEFAULT_FOLDER) not in sys.path:
        sys.path.append(str(DEFAULT_FOLDER))


def _is_installed(package: str, folder: Path) -> bool:
    spec = importlib.util.find_spec(package)
    if spec is None or not spec.submodule_search_locations:
        return False
    return all(folder not in Path(place).resolve().parents for place in spec.submodule_search_locations)


def _generate_package(package: str, folder: Path) -> None:
    target = folder / package
    version = hashlib.sha256(repr((message_definitions(package), SERVICES[package])).encode()).hexdigest()
    stamp = target / _STAMP
    if stamp.is_file() and stamp.read_text(encoding="utf-8") == version:
        return
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder, prefix=".new-") as work:
        made = _modules(package, Path(work))
        (made / _STAMP).write_text(version, encoding="utf-8")
        try:
            os.rename(made, target)
        except OSError:
            if not (stamp.is_file() and stamp.read_text(encoding="utf-8") == version):  # not made by another meanwhile
                shutil.rmtree(target)
                os.rename(made, target)


def _modules(package: str, work: Path) -> Path:
    """Generate a package within work -> its folder."""
    messages = _write(work / "msg", ".msg", message_definitions(package))
    services = _write(work / "srv", ".srv", SERVICES[package])
    search = {package: [str(work / "msg")], **{name: [_definitions(name)] for name in _DEPENDENCIES}}
    made = work / package
    _run(genpy.generator.MsgGenerator(), package, messages, made / "msg", search)
    _run(genpy.generator.SrvGenerator(), package, services, made / "srv", search)
    (made / "__init__.py").write_text("", encoding="utf-8")
    return made


def _write(folder: Path, extension: str, definitions: Dict[str, str]) -> List[str]:
    folder.mkdir()
    for name, text in definitions.items():
        (folder / f"{name}{extension}").write_text(text, encoding="utf-8")
    return [str(folder / f"{name}{extension}") for name in definitions]


def _run(generator, package: str, files: List[str], target: Path, search: Dict[str, List[str]]) -> None:
    target.mkdir(parents=True, exist_ok=True)
    if generator.generate_messages(package, files, str(target), search) != 0:
        raise RuntimeError(f"genpy refused the definitions of {package}; it said why above")
    genpy.generate_initpy.write_modules(str(target))


def _definitions(package: str) -> str:
    """The folder of an installed package's .msg files."""
    for prefix in ("/opt/ros/noetic/share", "/usr/share"):
        folder = Path(prefix) / package / "msg"
        if folder.is_dir():
            return str(folder)
    raise RuntimeError(f"the definitions of {package} are not installed: run tools/install.sh")


def main() -> int:
    """Generate into the folder that the command line names -> exit status."""
    if len(sys.argv) > 2:
        sys.stderr.write(f"usage: {sys.argv[0]} [FOLDER]\n")
        return 2
    made = generate(Path(sys.argv[1]).resolve() if len(sys.argv) == 2 else DEFAULT_FOLDER)
    sys.stdout.write(f"generated: {', '.join(made) or 'nothing, everything is installed'}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
