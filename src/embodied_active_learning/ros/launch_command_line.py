"""Check of the launch arguments on roslaunch's command line, where roslaunch ignores names that no <arg> declares."""

from __future__ import annotations

import os
from pathlib import Path
from typing import List, Optional, Sequence, Set, Tuple
from xml.etree import ElementTree

from roslaunch import _get_optparse  # roslaunch's own options
from roslaunch.core import RLException
from roslaunch.rlutil import resolve_launch_arguments

from embodied_active_learning.errors import ConfigError
from embodied_active_learning.schema import suggestion

_GENERATIONS = 4  # processes between a launch file's command and roslaunch, such as a shell


def check_launch_arguments() -> None:
    """Raise ConfigError if the roslaunch that runs this process was given an argument it does not know."""
    command_line = _roslaunch_command_line()
    if command_line is not None:
        check_command_line(command_line)


def check_command_line(arguments: Sequence[str]) -> None:
    """Raise ConfigError if an argument NAME:=VALUE is not declared in the launch files.

    Args:
        arguments: Arguments of roslaunch: options, a package and its launch files or paths of launch files, and
            NAME:=VALUE.
    """
    _, words = _get_optparse().parse_args(list(arguments))  # options such as "-p 11312" have values
    files = [word for word in words if ":=" not in word]
    names = [word.partition(":=")[0] for word in words if ":=" in word]
    try:
        declared, complete = _declared(resolve_launch_arguments(files))
    except (RLException, ElementTree.ParseError, OSError):
        return  # roslaunch reports it
    for name in names:
        if complete and name not in declared and not name.startswith("_"):
            known = sorted(declared)
            raise ConfigError(f"unknown launch argument {name}:={_hint(name, known)}")


def _hint(name: str, known: List[str]) -> str:
    hint = suggestion(name, known)
    return f": {hint[:-1]}:=?" if hint.endswith("?") else f": {hint}"


def _declared(paths: Sequence[str]) -> Tuple[Set[str], bool]:
    """Return the arguments of launch files, and False if an include passes on all arguments."""
    declared: Set[str] = set()
    complete = True
    for path in paths:
        root = ElementTree.parse(path).getroot()  # noqa: S314 - roslaunch parses the same file
        declared.update(item.get("name", "") for item in root.iter("arg") if item.get("value") is None)
        complete = complete and all(item.get("pass_all_args") != "true" for item in root.iter("include"))
    return declared, complete


def _roslaunch_command_line() -> Optional[List[str]]:
    """Return the arguments of the nearest parent process that is roslaunch, or None."""
    process = os.getppid()
    for _ in range(_GENERATIONS):
        try:
            words = Path(f"/proc/{process}/cmdline").read_bytes().decode("utf-8", "surrogateescape").split("\0")[:-1]
            status = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace")
        except OSError:
            return None
        for index, word in enumerate(words[:2]):  # "python3 /opt/ros/noetic/bin/roslaunch ..." or "roslaunch ..."
            if os.path.basename(word) == "roslaunch":
                return words[index + 1 :]
        process = int(status.rpartition(")")[2].split()[1])
    return None
