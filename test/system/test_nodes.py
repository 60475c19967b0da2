"""Runs every rostest file, each with its own master, and reports the failed cases."""

import os
import subprocess
from xml.etree import ElementTree

import pytest

from launching import ROOT

pytestmark = pytest.mark.ros

FILES = sorted((ROOT / "test" / "rostest").glob("*.test"))
TIMEOUT = 600  # s
LOG_TAIL = 5000  # characters


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_node_tests_pass(path, tmp_path):
    environment = {**os.environ, "ROS_HOME": str(tmp_path)}
    command = ["rostest", "embodied_active_learning", path.name]
    run = subprocess.run(command, env=environment, check=False, capture_output=True, text=True, timeout=TIMEOUT)
    results = list(tmp_path.glob("test_results/*/rosunit-*.xml"))
    unfinished = [found.stem for found in results if not found.stat().st_size]
    output = f"{run.stdout}{run.stderr}{_logs(tmp_path)}"
    assert not unfinished, f"{unfinished} ended before the results were written\n{output}"
    cases = [case for found in results for case in ElementTree.parse(found).getroot().iter("testcase")]
    failed = [case for case in cases if case.find("failure") is not None or case.find("error") is not None]
    report = "\n".join(f"{case.get('name')}: {''.join(case.itertext())}" for case in failed)
    assert run.returncode == 0, report or output
    assert cases, "the file ran no test"


def _logs(home):
    """Return the end of every log that the nodes have written."""
    return "".join(f"\n{path}:\n{path.read_text()[-LOG_TAIL:]}" for path in sorted(home.rglob("*.log")))
