"""No code of ours can run what it reads: what would do so is not called anywhere."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("src", "nodes", "scripts", "tools", "worlds", "benchmarks", "experiments")
MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "marshal", "shelve", "joblib"}
BUILT_IN = {"eval", "exec", "compile", "__import__"}
CALLS = {
    "torch.load", "torch.save", "torch.jit.load", "torch.package", "yaml.load", "yaml.load_all", "yaml.full_load",
    "yaml.unsafe_load", "np.fromfile", "np.memmap", "os.system", "os.popen", "pandas.read_pickle",
}  # fmt: skip
YAML_LOADERS = {"Loader", "UnsafeLoader", "FullLoader"}


def python_files():
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix == ".py" or (path.is_file() and not path.suffix and is_python(path)):
                yield path


def is_python(path):
    with path.open("rb") as stream:
        return stream.readline().startswith(b"#!/usr/bin/env python3")


def name_of(node):
    """Return the dotted name of an expression such as torch.load; empty for others."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute):
        return f"{name_of(node.value)}.{node.attr}"
    return ""


def dangers(source):
    """What a source text does that could run what it reads."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name.split(".")[0] in MODULES)
        elif isinstance(node, ast.ImportFrom):
            whole = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from (name for name in whole if name.split(".")[0] in MODULES or name in CALLS)
        elif isinstance(node, ast.Attribute) and name_of(node) in CALLS | {f"yaml.{name}" for name in YAML_LOADERS}:
            yield name_of(node)
        elif isinstance(node, ast.Call):
            yield from dangers_of_call(node)


def dangers_of_call(node):
    name = name_of(node.func)
    words = {word.arg: word.value for word in node.keywords}
    if name in BUILT_IN:
        yield name
    if "shell" in words and not is_false(words["shell"]):
        yield f"{name}(shell=...)"
    if name in ("np.load", "numpy.load") and not is_false(words.get("allow_pickle")):
        yield f"{name} without allow_pickle=False"
    elif "allow_pickle" in words and not is_false(words["allow_pickle"]):
        yield f"{name}(allow_pickle=...)"


def is_false(node):
    return isinstance(node, ast.Constant) and node.value is False


@pytest.mark.parametrize("path", python_files(), ids=lambda path: str(path.relative_to(ROOT)))
def test_no_code_execution_functions_are_called(path):
    assert list(dangers(path.read_text(encoding="utf-8"))) == []


def test_all_nodes_and_library_are_scanned():
    names = {path.name for path in python_files()}
    assert {"trainer", "identifier", "monitor", "resolve_config", "files.py", "check_session.py"} <= names
    assert len(names) > 100


@pytest.mark.parametrize(
    "source",
    [
        "import pickle",
        "from pickle import loads",
        "import torch\ntorch.load('x', weights_only=True)",
        "from torch import load",
        "import yaml\nyaml.load(text, Loader=yaml.SafeLoader)",
        "class L(yaml.FullLoader): pass",
        "np.load('x')",
        "np.load('x', allow_pickle=True)",
        "np.save('x', a, allow_pickle=flag)",
        "eval('1')",
        "subprocess.run('x', shell=True)",
        "f = os.system",
    ],
)
def test_dangerous_calls_are_detected(source):
    assert list(dangers(source))
