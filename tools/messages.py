"""Every message that the code can give, found in its syntax trees, beside the tables that tell what to do about it.

python3 tools/messages.py    lists each with the places that give it and the file that explains it

A message is what an error of the package says, a warning or worse on the log, a sentence of WARN or ERROR on
/diagnostics, what a service answers when it does not do as asked, or what a node says it is waiting for. What is put
into it when it is given stands as an ellipsis, unless it can be read in the code.
"""

from __future__ import annotations

import ast
import itertools
import re
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Callable, Dict, Iterable, Iterator, List, NamedTuple, Optional, Tuple

from embodied_active_learning.ros import names

ROOT = Path(__file__).resolve().parents[1]
TABLES = ("README.md", "docs/messages.md")
SOURCES = ("src/embodied_active_learning", "nodes", "scripts", "tools/check_session.py")
GAP = "…"
"""What stands for a value that only a run can tell."""
_CAUGHT = "\0"
"""What stands for an error that was caught: its own message is found where it is raised."""

_LOG_CALLS = re.compile(r"rospy\.(logwarn|logerr|logfatal)|_?LOG\.(warning|error|critical)")
_LEVELS = ("WARN", "ERROR")
_NOT_TOLD = ("ValueError", "EOFError", "OSError", "MemoryError", "RuntimeError", "ShutdownRequestedError")
"""Raised and caught inside, or programming errors that nobody foresees."""
_MAKERS = {
    # function: the message that it makes of its arguments
    "refuse": "{0} {1}: " + GAP,  # reading.FileReader: of the file and what is wrong; the reader adds its remedy
    "FileReader": "{1}",
    "_refuse_large": "{2}",
    "_error": "{0}",  # reading: a part of "is not plain YAML (...)"
    "awaiting": "waiting for {0}",
    "wait_until": "waiting for {1}",
    "_stand_still": "the arm stands still: {0}",
    "print": "{0}",
}
_PERCENT = re.compile(r"%[-+ #0]*\d*(?:\.\d+)?[a-zA-Z]")
_MOST_VARIANTS = 24
_DEEPEST = 8

Follow = Callable[..., List[str]]
Found = Dict[str, List[str]]


@dataclass
class Scope:
    """Where a piece of code stands: its module, and the class and functions around it."""

    module: Module
    owner: Optional[ast.ClassDef] = None
    functions: Tuple[ast.FunctionDef, ...] = ()

    def entered(self, node: ast.AST) -> Scope:
        """The scope inside a class or function."""
        if isinstance(node, ast.ClassDef):
            return Scope(self.module, node, ())
        if isinstance(node, ast.FunctionDef):
            return Scope(self.module, self.owner, (*self.functions, node))
        return self


@dataclass
class Module:
    """One file: its functions, its constants that are texts, and what it imports."""

    path: str
    tree: ast.Module
    functions: Dict[str, ast.FunctionDef] = field(default_factory=dict)
    texts: Dict[str, str] = field(default_factory=dict)
    imported: Dict[str, str] = field(default_factory=dict)  # local name: the whole one, with dots

    @property
    def name(self) -> str:
        """What other modules import it by."""
        return self.path.replace("src/", "").replace(".py", "").replace("/", ".")

    @classmethod
    def read(cls, path: Path) -> Module:
        """Parse a file."""
        tree = ast.parse(path.read_text(encoding="utf-8"))
        module = cls(str(path.relative_to(ROOT)), tree)
        for node in tree.body:
            if isinstance(node, ast.FunctionDef):
                module.functions[node.name] = node
            elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                if isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
                    module.texts[node.targets[0].id] = node.value.value
            elif isinstance(node, ast.ImportFrom):
                for name in node.names:
                    module.imported[name.asname or name.name] = f"{node.module}.{name.name}"
        return module


class Messages(NamedTuple):
    """What was found: messages, and the places whose whole text comes from elsewhere; each with its places."""

    templates: Found
    unseen: Found


class Scanner:
    """Follows texts to the places where they are written."""

    def __init__(self, modules: Iterable[Module]) -> None:
        self._modules = {module.name: module for module in modules}

    def scan(self) -> Messages:
        """Everything that the modules can say."""
        found = Messages({}, {})
        for module in self._modules.values():
            for node, scope in _nodes(module.tree, Scope(module)):
                for text in self._told(node, scope):
                    message = _normal(text)
                    if _CAUGHT in text and not _says(message):
                        continue
                    inside = ".".join(part.name for part in (scope.owner, *scope.functions) if part is not None)
                    if _says(message):
                        found.templates.setdefault(message, []).append(f"{module.path}:{node.lineno}")
                    else:
                        found.unseen.setdefault(f"{module.path}: {inside}", []).append(f"line {node.lineno}")
        return found

    def _told(self, node: ast.AST, scope: Scope) -> List[str]:
        """The messages that a node gives; none for most."""
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            return self._raised(node.exc, scope)
        if not isinstance(node, ast.Call):
            return []
        name, whole = _called(node), _dotted(node.func)
        if _LOG_CALLS.fullmatch(whole):
            return self._logged(node, scope)
        if name in ("Health", "replace") or name.endswith(("Response", "_response_class")):
            return self._answered(node, name, scope)
        return self._made(node, scope)

    def _made(self, call: ast.Call, scope: Scope) -> List[str]:
        """What is told by way of another function, or past the log."""
        name, whole = _called(call), _dotted(call.func)
        if whole == "sys.stderr.write" or (whole == "os.write" and getattr(call.args[0], "value", None) == 2):
            return self._texts(call.args[-1], scope)
        if name not in _MAKERS or (name == "print" and not any(keyword.arg == "file" for keyword in call.keywords)):
            return []
        arguments = [self._texts(argument, scope) for argument in call.args]
        wanted = [arguments[int(place)] for place in re.findall(r"\{(\d)\}", _MAKERS[name])]
        shape = re.sub(r"\{\d\}", "{}", _MAKERS[name])
        return [
            shape.format(*texts) if any(map(_says, texts)) else "".join(texts) for texts in itertools.product(*wanted)
        ]

    def _raised(self, call: ast.Call, scope: Scope) -> List[str]:
        name = _called(call)
        if name in _NOT_TOLD or name in _MAKERS or not call.args:
            return []
        if name == "error_of":
            return [GAP]
        makes_it, _ = self._function(call, scope)
        return [] if makes_it is not None else self._texts(call.args[0], scope)

    def _logged(self, call: ast.Call, scope: Scope) -> List[str]:
        texts: List[str] = []
        for text in self._texts(call.args[0], scope):
            places = _PERCENT.findall(text)
            values = [
                self._texts(value, scope) if place == "%s" else [GAP] for place, value in zip(places, call.args[1:])
            ]
            parts = [[part] for part in _PERCENT.split(text)]
            texts += _joined([part for pair in itertools.zip_longest(parts, values, fillvalue=[""]) for part in pair])
        return texts

    def _answered(self, call: ast.Call, name: str, scope: Scope) -> List[str]:
        """A diagnosis that is not OK, or the answer of a service that did not do as asked."""
        fields = {keyword.arg: keyword.value for keyword in call.keywords}
        state = fields.get("level" if name in ("Health", "replace") else "success")
        message = fields.get("message")
        if name != "replace" and len(call.args) > 1 and name != "GetTrajectoryResponse":  # which has neither
            state, message = call.args[:2]
        if state is None or message is None:
            return []
        if name in ("Health", "replace"):
            wrong = any(part.id in _LEVELS for part in ast.walk(state) if isinstance(part, ast.Name))
        else:
            wrong = getattr(state, "value", None) is not True
        return self._texts(message, scope) if wrong else []

    def _texts(self, node: ast.AST, scope: Scope, depth: int = 0) -> List[str]:
        """What an expression may say; a gap where that cannot be read in the code."""

        def follow(part: ast.AST, there: Scope = scope) -> List[str]:
            return self._texts(part, there, depth + 1)

        read = getattr(self, f"_of_{type(node).__name__.lower()}", None)
        return [GAP] if read is None or depth > _DEEPEST else read(node, scope, follow)

    @staticmethod
    def _of_constant(node: ast.Constant, _scope: Scope, _follow: Follow) -> List[str]:
        value = node.value
        return [value.decode() if isinstance(value, bytes) else "" if value is None else str(value)]

    def _of_joinedstr(self, node: ast.JoinedStr, _scope: Scope, follow: Follow) -> List[str]:
        return _joined(
            [follow(part) if isinstance(part, ast.Constant) else self._part(part, follow) for part in node.values]
        )

    @staticmethod
    def _of_binop(node: ast.BinOp, _scope: Scope, follow: Follow) -> List[str]:
        return _joined([follow(node.left), follow(node.right)]) if isinstance(node.op, ast.Add) else [GAP]

    @staticmethod
    def _of_ifexp(node: ast.IfExp, _scope: Scope, follow: Follow) -> List[str]:
        return _union([follow(node.body), follow(node.orelse)])

    @staticmethod
    def _of_boolop(node: ast.BoolOp, _scope: Scope, follow: Follow) -> List[str]:
        return _union(follow(part) for part in node.values)

    @staticmethod
    def _of_lambda(node: ast.Lambda, _scope: Scope, follow: Follow) -> List[str]:
        return follow(node.body)

    @staticmethod
    def _part(part: ast.FormattedValue, follow: Follow) -> List[str]:
        """What may stand in one place of a text: spelt out only where all that may is known."""
        if part.conversion != -1 or part.format_spec is not None or isinstance(part.value, ast.Attribute):
            return [GAP]
        texts = follow(part.value)
        return texts if all(not text or _says(text) for text in texts) else [GAP]

    @staticmethod
    def _of_name(node: ast.Name, scope: Scope, follow: Follow) -> List[str]:
        name = node.id
        for function in reversed(scope.functions):
            if name in [part.name for part in ast.walk(function) if isinstance(part, ast.ExceptHandler)]:
                return [_CAUGHT]
            values, known = _bindings(function, name)
            if not known:
                return [GAP]
            if values:
                texts = _union(follow(value) for value, added in values if not added)
                for value, added in values:
                    texts = _union([texts, _joined([texts, follow(value)])]) if added else texts
                return texts
        return [scope.module.texts.get(name, GAP)]

    def _of_attribute(self, node: ast.Attribute, scope: Scope, follow: Follow) -> List[str]:
        """What is ever put into an attribute of the class; its beginning as nothing says nothing."""
        target = f"self.{node.attr}"
        texts: List[str] = []
        if _dotted(node) != target:
            return self._of_property(node.attr, follow)
        for method in [] if scope.owner is None else _functions(scope.owner):
            inside = Scope(scope.module, scope.owner, (method,))
            for value in _values_of(method, target):
                texts += follow(value, inside)
        return [text for text in _union([texts]) if text] or [GAP]

    def _of_property(self, name: str, follow: Follow) -> List[str]:
        """What a property returns, if its name tells which one it is."""
        found = [
            (method, Scope(module, owner, (method,)))
            for module in self._modules.values()
            for owner in module.tree.body
            if isinstance(owner, ast.ClassDef)
            for method in _functions(owner)
            if method.name == name and any(_dotted(mark) == "property" for mark in method.decorator_list)
        ]
        return self._returns(*found[0], follow) if len(found) == 1 else [GAP]

    def _of_call(self, call: ast.Call, scope: Scope, follow: Follow) -> List[str]:
        name = _called(call)
        if name == "resolve_name" and isinstance(call.args[0], ast.Attribute):
            return [f"/{getattr(names, call.args[0].attr)}"]
        if name in ("encode", "strip") and isinstance(call.func, ast.Attribute):
            return follow(call.func.value)
        if name == "str":
            return follow(call.args[0])
        function, there = self._function(call, scope)
        return [GAP] if function is None else self._returns(function, there, follow)

    @staticmethod
    def _returns(function: ast.FunctionDef, there: Scope, follow: Follow) -> List[str]:
        returns = [node.value for node in ast.walk(function) if isinstance(node, ast.Return) and node.value is not None]
        texts = _union(follow(value, there) for value in returns)
        return [text for text in texts if text] or [GAP]

    def _function(self, call: ast.Call, scope: Scope) -> Tuple[Optional[ast.FunctionDef], Scope]:
        """The function that is called, if it is one of these modules', and the scope inside it."""
        name, whole = _called(call), _dotted(call.func)
        if whole == f"self.{name}" and scope.owner is not None:
            for method in _functions(scope.owner):
                if method.name == name:
                    return method, Scope(scope.module, scope.owner, (method,))
        module: Optional[Module] = scope.module
        if whole not in scope.module.functions:
            first = whole.split(".")[0]
            whole = scope.module.imported.get(first, first) + whole[len(first) :]
            module = self._modules.get(whole.rpartition(".")[0])
        function = module.functions.get(name) if module is not None else None
        return function, Scope(module or scope.module, None, () if function is None else (function,))


def find_messages() -> Messages:
    """Everything that the package can say."""
    files: List[Path] = []
    for source in SOURCES:
        path = ROOT / source
        files += sorted(file for file in path.rglob("*") if _is_python(file)) if path.is_dir() else [path]
    return Scanner(map(Module.read, files)).scan()


def explained(table: str) -> List[str]:
    """The messages in the tables of a Markdown file: all that stands in backquotes in a first cell under "message"."""
    messages: List[str] = []
    inside = False
    for line in (ROOT / table).read_text(encoding="utf-8").splitlines():
        if not line.startswith("|"):
            inside = False
        elif line.startswith("| message |"):
            inside = True
        elif inside:
            messages += re.findall(r"`([^`]+)`", re.split(r"(?<!\\)\|", line)[1])
    return messages


def _nodes(tree: ast.AST, scope: Scope) -> Iterator[Tuple[ast.AST, Scope]]:
    for child in ast.iter_child_nodes(tree):
        yield child, scope
        yield from _nodes(child, scope.entered(child))


def _functions(owner: ast.ClassDef) -> List[ast.FunctionDef]:
    return [node for node in owner.body if isinstance(node, ast.FunctionDef)]


def _bindings(function: ast.FunctionDef, name: str) -> Tuple[List[Tuple[ast.AST, bool]], bool]:
    """What a local name is given, and whether that is added to what it has; and whether that is all it can be."""
    elsewhere = {item.arg for item in ast.walk(function.args) if isinstance(item, ast.arg)}
    values: List[Tuple[ast.AST, bool]] = [(value, False) for value in _values_of(function, name)]
    for node in ast.walk(function):
        if isinstance(node, ast.AugAssign) and _dotted(node.target) == name:
            values.append((node.value, True))
        elif isinstance(node, (ast.For, ast.comprehension)):
            elsewhere.update(_names_in(node.target))
        elif isinstance(node, ast.withitem) and node.optional_vars is not None:
            elsewhere.update(_names_in(node.optional_vars))
    if name in elsewhere:
        return [], False
    return values, True


def _values_of(function: ast.FunctionDef, target: str) -> List[ast.AST]:
    """What a function assigns to a name, or to an attribute such as self.reason."""
    values: List[ast.AST] = []
    for node in ast.walk(function):
        if isinstance(node, ast.AnnAssign) and node.value is not None and _dotted(node.target) == target:
            values.append(node.value)
        elif isinstance(node, ast.Assign):
            for place in node.targets:
                if _dotted(place) == target:
                    values.append(node.value)
                elif isinstance(place, ast.Tuple):
                    whole = isinstance(node.value, ast.Tuple) and len(node.value.elts) == len(place.elts)
                    for index, part in enumerate(place.elts):
                        if _dotted(part) == target:
                            values.append(node.value.elts[index] if whole else ast.Set(elts=[]))
    return values


def _names_in(node: ast.AST) -> List[str]:
    return [part.id for part in ast.walk(node) if isinstance(part, ast.Name)]


def _called(call: ast.Call) -> str:
    """The last part of what is called: what a call of a call is called by does not matter."""
    function = call.func
    return getattr(function, "attr", getattr(function, "id", ""))


def _dotted(node: ast.AST) -> str:
    """A name, or names joined by dots, as they are written; nothing for everything else."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute):
        before = _dotted(node.value)
        return f"{before}.{node.attr}" if before else ""
    return ""


def _says(text: str) -> bool:
    """Whether a text says anything but what is put into it."""
    return re.search("[a-zA-Z]", text) is not None


def _is_python(path: Path) -> bool:
    if not path.is_file() or "__pycache__" in path.parts:
        return False
    return path.suffix == ".py" or (not path.suffix and path.read_bytes()[:40].split(b"\n")[0].endswith(b"python3"))


def _union(lists: Iterable[List[str]]) -> List[str]:
    return list(dict.fromkeys(itertools.chain.from_iterable(lists)))


def _joined(parts: List[List[str]]) -> List[str]:
    variants = ["".join(texts) for texts in itertools.islice(itertools.product(*parts), _MOST_VARIANTS + 1)]
    if len(variants) > _MOST_VARIANTS:
        return ["".join(texts[0] if len(texts) == 1 else GAP for texts in parts)]
    return variants


def _normal(text: str) -> str:
    """One line, with one gap where several follow each other."""
    return re.sub(f"{GAP}+", GAP, " ".join(text.replace(_CAUGHT, GAP).split()))


def main() -> int:
    """List everything -> exit status: 1 when something is not explained, or explained though nobody says it."""
    found = find_messages()
    places = {message: table for table in TABLES for message in explained(table)}
    for message, where in sorted(found.templates.items(), key=lambda item: item[1]):
        print(f"{places.get(message, 'NOWHERE'):16} {message}\n{'':17}{', '.join(where)}")
    for place, lines in sorted(found.unseen.items()):
        print(f"{'not seen':16} {place} ({', '.join(lines)})")
    stale = [message for message in places if message not in found.templates]
    for message in stale:
        print(f"{'SAID BY NOBODY':16} {message} ({places[message]})")
    return int(bool(stale or set(found.templates) - set(places)))


if __name__ == "__main__":
    sys.exit(main())
