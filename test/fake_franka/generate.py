#!/usr/bin/env python3
"""Makes Python modules of franka_definitions.py, for machines where franka_ros is not installed.

python3 test/fake_franka/generate.py FOLDER    then put FOLDER at the end of PYTHONPATH

A package that is installed is never generated again, and so never hidden.
"""

from __future__ import annotations

import importlib.util
import sys
import tempfile
from pathlib import Path
from typing import Dict, List

import genpy.generate_initpy
import genpy.generator

sys.path.insert(0, str(Path(__file__).resolve().parent))

from franka_definitions import SERVICES, message_definitions

PACKAGES = tuple(sorted(SERVICES))
_DEPENDENCIES = ("std_msgs", "actionlib_msgs")


def missing_packages(folder: Path) -> List[str]:
    """The packages that cannot be imported from anywhere but folder."""
    return [name for name in PACKAGES if not _is_installed(name, folder)]


def generate(folder: Path) -> List[str]:
    """Write the modules of every package that is not installed into folder -> their names.

    Raises RuntimeError when genpy refuses a definition or the definitions of a dependency are not installed.
    """
    names = missing_packages(folder)
    for name in names:
        _generate_package(name, folder)
    return names


def _is_installed(package: str, folder: Path) -> bool:
    spec = importlib.util.find_spec(package)
    if spec is None or not spec.submodule_search_locations:
        return False
    return all(folder not in Path(place).resolve().parents for place in spec.submodule_search_locations)


def _generate_package(package: str, folder: Path) -> None:
    with tempfile.TemporaryDirectory() as texts:
        messages = _write(Path(texts) / "msg", ".msg", message_definitions(package))
        services = _write(Path(texts) / "srv", ".srv", SERVICES[package])
        search = {package: [str(Path(texts) / "msg")], **{name: [_definitions(name)] for name in _DEPENDENCIES}}
        target = folder / package
        _run(genpy.generator.MsgGenerator(), package, messages, target / "msg", search)
        _run(genpy.generator.SrvGenerator(), package, services, target / "srv", search)
        (target / "__init__.py").write_text("", encoding="utf-8")


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
    if len(sys.argv) != 2:
        sys.stderr.write(f"usage: {sys.argv[0]} FOLDER\n")
        return 2
    made = generate(Path(sys.argv[1]).resolve())
    sys.stdout.write(f"generated: {', '.join(made) or 'nothing, everything is installed'}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
