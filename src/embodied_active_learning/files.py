"""Reading files that somebody may have damaged, exchanged or made up: plain files of bounded size, and plain data.

What is refused is named: the file, what is wrong with it, and what to do about it. Nothing in a file is ever run.
"""

from __future__ import annotations

import errno
import json
import os
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Dict, List, Mapping, Type

import yaml

from embodied_active_learning.errors import EmbodiedActiveLearningError

LARGEST_YAML = 2**18
"""Bytes of the largest YAML file that is read: many times the largest of ours, and read within seconds."""

_DEEPEST = 32  # levels of YAML or JSON; more would only serve to exhaust the interpreter's stack
_LONGEST_NUMBER = 64  # characters; longer ones fit no setting, and take ever longer to convert
_SHOWN = 200  # characters of a value in a message
_KINDS = (
    (stat.S_ISDIR, "it is a folder"),
    (stat.S_ISLNK, "it is a symbolic link"),
    (stat.S_ISFIFO, "it is a named pipe"),
    (stat.S_ISSOCK, "it is a socket"),
    (stat.S_ISCHR, "it is a device"),
    (stat.S_ISBLK, "it is a device"),
)


def open_plain(path: Path, mode: str = "rb", follow: bool = False) -> BinaryIO:
    """Open a regular file without a buffer, to read ("rb") or to read and write ("r+b", which makes it when missing).

    Raises OSError for everything that is no regular file, without opening it: a pipe would block, a device may act. A
    symbolic link as the last part of the path is one such thing unless it is to be followed.
    """
    _refuse_special(path, follow)
    flags = os.O_RDONLY if mode == "rb" else os.O_RDWR | os.O_CREAT
    flags |= os.O_CLOEXEC | os.O_NONBLOCK | (0 if follow else os.O_NOFOLLOW)
    stream = os.fdopen(os.open(path, flags, 0o666), mode, buffering=0)
    try:
        _refuse_kind(os.fstat(stream.fileno()).st_mode)  # it may have been exchanged meanwhile
    except OSError:
        stream.close()
        raise
    return stream


@dataclass(frozen=True)
class FileReader:
    """Reads files of one kind.

    error is raised for whatever is wrong, remedy is the end of its message, limit is the most bytes that are read, and
    follow says whether the file may be a symbolic link, as the files of people are and those of a session are not.
    """

    error: Type[EmbodiedActiveLearningError]
    remedy: str
    limit: int = LARGEST_YAML
    follow: bool = False

    def refuse(self, subject: Any, complaint: str) -> EmbodiedActiveLearningError:
        """The error to raise about a file, or a place in it."""
        return self.error(f"{subject} {complaint}: {self.remedy}")

    def check(self, path: Path) -> int:
        """Refuse what is no regular file, or too large to be read. -> its size in bytes."""
        with self._open(path) as stream:
            return self._size(path, stream)

    def read_bytes(self, path: Path) -> bytes:
        """The content of a file, which is not read when it is too large."""
        with self._open(path) as stream:
            size = self._size(path, stream)
            try:
                return _read(stream, size)
            except OSError as error:
                raise self._unreadable(path, error) from error

    def read_text(self, path: Path) -> str:
        """The content of a UTF-8 file."""
        try:
            return self.read_bytes(path).decode("utf-8")
        except UnicodeDecodeError as error:
            raise self.refuse(path, f"is no UTF-8 text ({error})") from error

    def read_yaml(self, path: Path) -> Dict[str, Any]:
        """The fields of a YAML file, as parse_yaml reads them."""
        text = self.read_text(path)
        try:
            content = parse_yaml(text)
        except ValueError as error:
            raise self.refuse(path, f"is not plain YAML ({error})") from error
        return self._fields(path, content)

    def read_json(self, path: Path) -> Dict[str, Any]:
        """The fields of a JSON file."""
        return self.parse_json(path, self.read_text(path))

    def parse_json(self, subject: Any, text: str) -> Dict[str, Any]:
        """The fields of a JSON text that was found in the subject, which names it in messages."""
        try:
            content = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise self.refuse(subject, f"is not JSON ({error})") from error
        return self._fields(subject, content)

    def expect(self, subject: Any, content: Mapping[str, Any], expected: Mapping[str, Any]) -> None:
        """Refuse content whose fields have other values than those expected."""
        for field, value in expected.items():
            found = content.get(field)
            if repr(found) != repr(value):  # 1, 1.0 and True are equal, but not in a file
                raise self.error(f"{subject}: {field} is {shown(found)}: expected {shown(value)}; {self.remedy}")

    def _fields(self, subject: Any, content: Any) -> Dict[str, Any]:
        if not isinstance(content, dict):
            raise self.refuse(subject, f"is {_kind(content)}, expected fields")
        return content

    def _open(self, path: Path) -> BinaryIO:
        try:
            return open_plain(path, follow=self.follow)
        except (OSError, ValueError) as error:  # the latter for names that no file can have
            raise self._unreadable(path, error) from error

    def _size(self, path: Path, stream: BinaryIO) -> int:
        size = os.fstat(stream.fileno()).st_size
        if size > self.limit:
            raise self.refuse(path, f"has {size} bytes, and {self.limit} are allowed")
        return size

    def _unreadable(self, path: Path, error: Exception) -> EmbodiedActiveLearningError:
        if isinstance(error, FileNotFoundError):
            return self.refuse(path, "is missing")
        return self.refuse(path, f"cannot be read ({getattr(error, 'strerror', None) or error})")


def parse_yaml(text: str) -> Any:
    """Plain data: texts, numbers, truth values, nothing, lists, and mappings whose keys are texts, each there once.

    Raises ValueError for everything else. Tags are refused, because they could ask for more than data, and anchors,
    because a few lines of them stand for more data than any memory holds; so are nesting and numbers beyond all use.
    """
    try:
        loader = _PlainLoader(text)
        try:
            return loader.get_single_data()
        finally:
            loader.dispose()
    except yaml.YAMLError as error:
        raise ValueError(_in_words(error)) from error


def shown(value: Any) -> str:
    """A value as a message shows it, however large it is."""
    text = repr(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


class _PlainLoader(yaml.SafeLoader):
    """SafeLoader without what plain data does not need."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = 0

    def compose_node(self, parent: Any, index: Any) -> yaml.Node:
        event = self.peek_event()
        if isinstance(event, yaml.AliasEvent):
            raise _error("anchors are not understood, write the value out", event.start_mark)
        if event.tag is not None:
            raise _error(f"the tag {shown(event.tag)} is not understood, write the value alone", event.start_mark)
        if self._depth == _DEEPEST:
            raise _error(f"it is nested deeper than {_DEEPEST} levels", event.start_mark)
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> Dict[str, Any]:
        keys = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, str):
                raise _error(f"{shown(key)} is no text, as names are: put it in quotes", key_node.start_mark)
            if key in keys:
                raise _error(f"{shown(key)} stands twice", key_node.start_mark)
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
        """Refuse what YAML 1.1 reads as another number than people expect: 1:30 as 90, and 010 as 8."""
        if len(node.value) > _LONGEST_NUMBER:
            raise _error(f"a number has {len(node.value)} digits", node.start_mark)
        digits = node.value.lstrip("+-")
        if ":" in digits:
            raise _error(f"{node.value} is a base-60 number in YAML, write it as a decimal number", node.start_mark)
        if len(digits) > 1 and digits[0] == "0" and digits.isdecimal():
            raise _error(f"{node.value} is an octal number in YAML, drop the leading zero", node.start_mark)


_PlainLoader.add_constructor("tag:yaml.org,2002:int", _PlainLoader.construct_yaml_int)
_PlainLoader.add_constructor("tag:yaml.org,2002:float", _PlainLoader.construct_yaml_float)


def _error(complaint: str, mark: yaml.Mark) -> yaml.MarkedYAMLError:
    return yaml.constructor.ConstructorError(None, None, complaint, mark)


def _in_words(error: yaml.YAMLError) -> str:
    """What is wrong, in one line."""
    mark = getattr(error, "problem_mark", None)
    if mark is None:
        return " ".join(str(error).split())
    return f"line {mark.line + 1}: {', '.join(part for part in (error.context, error.problem) if part)}"


def _refuse_special(path: Path, follow: bool) -> None:
    try:
        mode = os.stat(path, follow_symlinks=follow).st_mode
    except FileNotFoundError:
        return
    _refuse_kind(mode)


def _refuse_kind(mode: int) -> None:
    if not stat.S_ISREG(mode):
        kind = next((words for is_kind, words in _KINDS if is_kind(mode)), "it is no plain file")
        raise OSError(errno.EINVAL, kind)


def _read(stream: BinaryIO, size: int) -> bytes:
    """The first bytes of a file, fewer when it has become shorter; not what was appended since."""
    parts: List[bytes] = []
    while size > 0:
        parts.append(stream.read(size))
        if not parts[-1]:
            break
        size -= len(parts[-1])
    return b"".join(parts)


def _kind(content: Any) -> str:
    return "empty" if content is None else f"a {type(content).__name__}"
