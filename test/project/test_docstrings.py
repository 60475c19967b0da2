"""Everything public is documented, because the API pages consist of the docstrings."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
MODULES = sorted((ROOT / "src").rglob("*.py"))


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT / "src")))
def test_public_names_have_docstrings(path):
    """The API pages consist of the docstrings of modules, public classes, functions and methods."""
    undocumented = []

    def visit(node, name):
        if ast.get_docstring(node) is None:
            undocumented.append(name)
        for child in ast.iter_child_nodes(node):
            kinds = (ast.ClassDef, ast.FunctionDef) if not isinstance(node, ast.FunctionDef) else ()
            if isinstance(child, kinds) and not child.name.startswith("_"):
                visit(child, f"{name}.{child.name}")

    visit(ast.parse(path.read_text(encoding="utf-8")), path.stem)
    assert undocumented == []
