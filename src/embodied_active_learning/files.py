"""Safe reading of untrusted files: regular files of bounded size, and plain data that is never executed.

Errors name the file, the problem and the remedy.
"""

from __future__ import annotations

import errno
import json
import os
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Dict, Hashable, List, Mapping, Optional, Type, cast

import yaml

from embodied_active_learning.errors import EmbodiedActiveLearningError

MAX_YAML_SIZE = 2**18
"""Largest YAML file that is read [bytes]; it is parsed within seconds."""

_DEEPEST = 32  # levels of nesting, to protect the interpreter's stack
_MAX_NUMBER_LENGTH = 64  # characters; the conversion of long integers is slow
_SHOWN = 200  # characters of a value in a message
_KINDS = (
    (stat.S_ISDIR, "it is a folder"),
    (stat.S_ISLNK, "it is a symbolic link"),
    (stat.S_ISFIFO, "it is a named pipe"),
    (stat.S_ISSOCK, "it is a socket"),
    (stat.S_ISCHR, "it is a device"),
    (stat.S_ISBLK, "it is a device"),
)


def open_regular_file(path: Path, mode: str = "rb", follow: bool = False) -> BinaryIO:
    """Open a regular file unbuffered.

    Args:
        path: The file.
        mode: "rb" to read, or "r+b" to read and write; the latter creates a missing file.
        follow: Accept a symbolic link as the last part of the path.

    Raises:
        OSError: The path is not a regular file. It is then not opened, because pipes block and devices may act.
    """
    _refuse_special(path, follow)
    flags = os.O_RDONLY if mode == "rb" else os.O_RDWR | os.O_CREAT
    flags |= os.O_CLOEXEC | os.O_NONBLOCK | (0 if follow else os.O_NOFOLLOW)
    stream = cast(BinaryIO, os.fdopen(os.open(path, flags, 0o666), mode, buffering=0))
    try:
        _refuse_kind(os.fstat(stream.fileno()).st_mode)  # it may have been replaced meanwhile
    except OSError:
        stream.close()
        raise
    return stream


@dataclass(frozen=True)
class FileReader:
    """Reads files of one kind.

    Attributes:
        error: Exception class for all problems.
        remedy: End of each message about the content; with `follow`, other messages end with a remedy of their own.
        limit: Largest file that is read [bytes].
        follow: Accept symbolic links, as for files of users; the files of a session are never links.
    """

    error: Type[EmbodiedActiveLearningError]
    remedy: str
    limit: int = MAX_YAML_SIZE
    follow: bool = False

    def make_error(self, subject: Any, complaint: str) -> EmbodiedActiveLearningError:
        """Return the exception for a problem with a file or a place in it."""
        return self.error(f"{subject} {complaint}: {self.remedy}")

    def check(self, path: Path) -> int:
        """Check that a file is regular and not too large. Return its size in bytes."""
        with self._open(path) as stream:
            return self._size(path, stream)

    def read_bytes(self, path: Path) -> bytes:
        """Return the content of a file that is not too large."""
        with self._open(path) as stream:
            size = self._size(path, stream)
            try:
                return _read(stream, size)
            except OSError as error:
                raise self._unreadable(path, error) from error

    def read_text(self, path: Path) -> str:
        """Return the content of a UTF-8 file."""
        try:
            return self.read_bytes(path).decode("utf-8")
        except UnicodeDecodeError as error:
            raise self.make_error(path, f"is not UTF-8 text ({error})") from error

    def read_yaml(self, path: Path) -> Dict[str, Any]:
        """Return the fields of a YAML file, see parse_yaml."""
        text = self.read_text(path)
        try:
            content = parse_yaml(text)
        except ValueError as error:
            raise self.make_error(path, f"is not plain YAML ({error})") from error
        return self._fields(path, content)

    def read_json(self, path: Path) -> Dict[str, Any]:
        """Return the fields of a JSON file."""
        return self.parse_json(path, self.read_text(path))

    def parse_json(self, subject: Any, text: str) -> Dict[str, Any]:
        """Return the fields of a JSON text. subject: origin of the text for messages."""
        try:
            content = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise self.make_error(subject, f"is not JSON ({error})") from error
        return self._fields(subject, content)

    def expect(self, subject: Any, content: Mapping[str, Any], expected: Mapping[str, Any]) -> None:
        """Check that fields have the expected values."""
        for field, value in expected.items():
            found = content.get(field)
            if repr(found) != repr(value):  # 1, 1.0 and True are equal, but not in a file
                raise self.error(
                    f"{subject}: {field} is {short_repr(found)}: expected {short_repr(value)}; {self.remedy}"
                )

    def expect_version(self, subject: Any, content: Mapping[str, Any], supported: Any) -> None:
        """Check that a file is of the version that this package reads."""
        found = content.get("version")
        if repr(found) != repr(supported):
            raise self.error(
                f"{subject}: version is {short_repr(found)}, but this package reads version {supported!r} only: use "
                f"the version of embodied_active_learning that wrote it; otherwise {self.remedy}"
            )

    def _fields(self, subject: Any, content: Any) -> Dict[str, Any]:
        if not isinstance(content, dict):
            raise self.make_error(subject, f"is {_kind(content)}, expected fields")
        return content

    def _open(self, path: Path) -> BinaryIO:
        try:
            return open_regular_file(path, follow=self.follow)
        except (OSError, ValueError) as error:  # ValueError: the name contains a null character
            raise self._unreadable(path, error) from error

    def _size(self, path: Path, stream: BinaryIO) -> int:
        size = os.fstat(stream.fileno()).st_size
        if size > self.limit:
            raise self.make_error(path, f"has {size} bytes, at most {self.limit} are allowed")
        return size

    def _unreadable(self, path: Path, error: Exception) -> EmbodiedActiveLearningError:
        # A user's file may have another path or owner; a file of a session has to be restored.
        remedy = "check path and permissions" if self.follow else self.remedy
        if isinstance(error, FileNotFoundError):
            return self.error(f"{path} is missing: {remedy}")
        return self.error(f"{path} cannot be read ({getattr(error, 'strerror', None) or error}): {remedy}")


def parse_yaml(text: str) -> Any:
    """Parse YAML into texts, numbers, booleans, None, lists, and dictionaries with unique text keys.

    Raises:
        ValueError: The text is not YAML, or uses tags (which can create objects), anchors (a few lines of which can
            expand to more data than fits into memory), deep nesting, or ambiguous numbers.
    """
    try:
        loader = _PlainLoader(text)
        try:
            return loader.get_single_data()
        finally:
            loader.dispose()
    except yaml.YAMLError as error:
        raise ValueError(_in_words(error)) from error


def short_repr(value: Any) -> str:
    """Return the representation of a value for messages, truncated if it is long."""
    text = repr(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


class _PlainLoader(yaml.SafeLoader):
    """SafeLoader restricted to plain data."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = 0

    def compose_node(self, parent: Any, index: Any) -> Optional[yaml.Node]:
        event: Any = self.peek_event()
        if isinstance(event, yaml.AliasEvent):
            raise _error("anchors are not supported, repeat the value", event.start_mark)
        if event.tag is not None:
            raise _error(f"the tag {short_repr(event.tag)} is not supported, write the value only", event.start_mark)
        if self._depth == _DEEPEST:
            raise _error(f"nested deeper than {_DEEPEST} levels", event.start_mark)
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> Dict[Hashable, Any]:
        keys = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, str):
                raise _error(f"key {short_repr(key)} is not a text: put it in quotes", key_node.start_mark)
            if key in keys:
                raise _error(f"duplicate key {short_repr(key)}", key_node.start_mark)
            keys.add(key)
        return super().construct_mapping(node, deep)

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
        self._check_number(node)
        return super().construct_yaml_int(node)

    def construct_yaml_float(self, node: yaml.ScalarNode) -> float:
        self._check_number(node)
        return super().construct_yaml_float(node)

    @staticmethod
    def _check_number(node: yaml.ScalarNode) -> None:
        """Refuse numbers that YAML 1.1 interprets unexpectedly: 1:30 as 90, and 010 as 8."""
        if len(node.value) > _MAX_NUMBER_LENGTH:
            raise _error(f"a number has {len(node.value)} digits", node.start_mark)
        digits = node.value.lstrip("+-").replace("_", "")
        if ":" in digits:
            raise _error(f"{node.value} is a base-60 number in YAML, write it as a decimal number", node.start_mark)
        if len(digits) > 1 and digits[0] == "0" and digits.isdecimal():
            raise _error(f"{node.value} is an octal number in YAML, drop the leading zero", node.start_mark)


_PlainLoader.yaml_implicit_resolvers = {  # without dates: 2026-11-28 is a text
    start: [(tag, pattern) for tag, pattern in resolvers if tag != "tag:yaml.org,2002:timestamp"]
    for start, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_PlainLoader.add_constructor("tag:yaml.org,2002:int", _PlainLoader.construct_yaml_int)
_PlainLoader.add_constructor("tag:yaml.org,2002:float", _PlainLoader.construct_yaml_float)


def _error(complaint: str, mark: Any) -> yaml.MarkedYAMLError:
    return yaml.constructor.ConstructorError(None, None, complaint, mark)


def _in_words(error: yaml.YAMLError) -> str:
    """Return a one-line description of a YAML error."""
    mark = getattr(error, "problem_mark", None)
    if mark is None:
        return " ".join(str(error).split())
    parts = (getattr(error, "context", None), getattr(error, "problem", None))
    return f"line {mark.line + 1}: {', '.join(part for part in parts if part)}"


def _refuse_special(path: Path, follow: bool) -> None:
    try:
        mode = os.stat(path, follow_symlinks=follow).st_mode
    except FileNotFoundError:
        return
    _refuse_kind(mode)


def _refuse_kind(mode: int) -> None:
    if not stat.S_ISREG(mode):
        kind = next((words for is_kind, words in _KINDS if is_kind(mode)), "it is not a regular file")
        raise OSError(errno.EINVAL, kind)


def _read(stream: BinaryIO, size: int) -> bytes:
    """Read up to size bytes: fewer if the file was truncated meanwhile, and nothing that was appended."""
    parts: List[bytes] = []
    while size > 0:
        parts.append(stream.read(size))
        if not parts[-1]:
            break
        size -= len(parts[-1])
    return b"".join(parts)


def _kind(content: Any) -> str:
    return "empty" if content is None else f"a {type(content).__name__}"
