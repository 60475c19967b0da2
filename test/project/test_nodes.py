"""Runs every rostest file, each with its own master, and reports the failed cases."""

import os
import subprocess
from concurrent.futures import ThreadPoolExecutor
from xml.etree import ElementTree

import pytest

from launching import ROOT

pytestmark = pytest.mark.ros

FILES = sorted(path for folder in ("rostest", "faults") for path in (ROOT / "test" / folder).glob("*.test"))
AT_ONCE = 2
"""Number of files that run in parallel: most of the time their nodes wait."""
TIMEOUT = 600  # s
LOG_TAIL = 5000  # characters


@pytest.fixture(scope="module")
def runs(request, tmp_path_factory):
    """The runs of the selected files in test order: path -> future of (run, folder)."""
    selected = [item.callspec.params["path"] for item in request.session.items if item.module is request.module]
    with ThreadPoolExecutor(AT_ONCE) as pool:
        futures = {path: pool.submit(_run, path, tmp_path_factory.mktemp(path.stem)) for path in selected}
        yield futures
        for future in futures.values():
            future.cancel()


def _run(path, home):
    environment = {**os.environ, "ROS_HOME": str(home)}
    command = ["rostest", "embodied_active_learning", path.name]
    run = subprocess.run(command, env=environment, check=False, capture_output=True, text=True, timeout=TIMEOUT)
    return run, home


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_node_tests_pass(path, runs):
    run, home = runs[path].result()
    results = list(home.glob("test_results/*/rosunit-*.xml"))
    unfinished = [found.stem for found in results if not found.stat().st_size]
    assert not unfinished, f"{unfinished} ended before the results were written\n{run.stdout}{run.stderr}{_logs(home)}"
    cases = [case for found in results for case in ElementTree.parse(found).getroot().iter("testcase")]
    failed = [case for case in cases if case.find("failure") is not None or case.find("error") is not None]
    report = "\n".join(f"{case.get('name')}: {''.join(case.itertext())}" for case in failed)
    assert run.returncode == 0, report or run.stdout + run.stderr
    assert cases, "the file ran no test"


def _logs(home):
    """Return the end of every log that the nodes have written."""
    return "".join(f"\n{path}:\n{path.read_text()[-LOG_TAIL:]}" for path in sorted(home.rglob("*.log")))
