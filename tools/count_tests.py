"""Print 'N passed, N failed, N skipped' of all given JUnit files."""

import argparse
import sys
from xml.etree import ElementTree

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("files", nargs="+", help="JUnit files")
counts = {"tests": 0, "failures": 0, "errors": 0, "skipped": 0}
for path in parser.parse_args().files:
    for suite in ElementTree.parse(path).getroot().iter("testsuite"):  # noqa: S314  written by our test runner
        for key in counts:
            counts[key] += int(suite.get(key, 0))
failed = counts["failures"] + counts["errors"]
passed = counts["tests"] - failed - counts["skipped"]
sys.stdout.write(f"{passed} passed, {failed} failed, {counts['skipped']} skipped\n")
