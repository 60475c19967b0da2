#!/usr/bin/env bash
# Runs every test, library and nodes, and ends with their count and a truthful exit status.
# Arguments go to pytest: tools/test.sh test/ground/test_config.py -k unknown
set -eo pipefail  # not -u: ROS's own set-up files read variables that are not set
cd "$(dirname "$0")/.."
source ./setup.bash
# Whatever the tests leave behind goes here, not into the user's ~/.ros.
ROS_HOME="$(mktemp -d)"
export ROS_HOME
trap 'rm -rf "$ROS_HOME"' EXIT
status=0
python3 -m pytest -p no:cacheprovider --junitxml=build/tests.xml "$@" || status=$?
python3 tools/count_tests.py build/tests.xml
exit "$status"
