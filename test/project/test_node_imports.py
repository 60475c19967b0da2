"""Nodes start without slow imports that they do not need yet."""

import subprocess
import sys

import pytest

from launching import ROOT

LARGE = ["torch", "sklearn", "matplotlib"]


@pytest.mark.parametrize(
    ("node", "missing"),
    [
        ("ergodic_planner", LARGE),
        ("fingerprinter", LARGE),
        ("monitor", LARGE),
        ("pybullet_arm", LARGE),
        ("trainer", ["sklearn", "matplotlib"]),
    ],
)
def test_node_starts_without_large_libraries(node, missing):
    program = f"""
import runpy, sys
runpy.run_path({str(ROOT / "nodes" / node)!r})
print([name for name in {missing} if name in sys.modules])
"""
    ended = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    assert ended.stdout.splitlines()[-1] == "[]"
