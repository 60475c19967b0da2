"""Print 'N passed, N failed, N skipped' from a JUnit file."""

import sys
from xml.etree import ElementTree

suites = ElementTree.parse(sys.argv[1]).getroot().iter("testsuite")  # noqa: S314  written by our test runner
counts = {"tests": 0, "failures": 0, "errors": 0, "skipped": 0}
for suite in suites:
    for key in counts:
        counts[key] += int(suite.get(key, 0))
failed = counts["failures"] + counts["errors"]
passed = counts["tests"] - failed - counts["skipped"]
sys.stdout.write(f"{passed} passed, {failed} failed, {counts['skipped']} skipped\n")
