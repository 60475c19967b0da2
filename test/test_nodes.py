"""Runs every rostest file, each with a master of its own, and tells what failed in it."""

import os
import subprocess
from xml.etree import ElementTree

import pytest

from launching import ROOT

FILES = sorted(path for folder in ("rostest", "faults") for path in (ROOT / "test" / folder).glob("*.test"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_node_tests_pass(path, tmp_path):
    environment = {**os.environ, "ROS_HOME": str(tmp_path)}
    command = ["rostest", "embodied_active_learning", path.name]
    run = subprocess.run(command, env=environment, check=False, capture_output=True, text=True, timeout=400)
    results = [ElementTree.parse(found).getroot() for found in tmp_path.glob("test_results/*/rosunit-*.xml")]
    cases = [case for root in results for case in root.iter("testcase")]
    failed = [case for case in cases if case.find("failure") is not None or case.find("error") is not None]
    report = "\n".join(f"{case.get('name')}: {''.join(case.itertext())}" for case in failed)
    assert run.returncode == 0, report or run.stdout + run.stderr
    assert cases, "the file ran no test"
