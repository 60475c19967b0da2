#!/usr/bin/env bash
# Runs the tests and prints their count. Arguments go to pytest: tools/test.sh test/ground/test_config.py -k unknown
set -eo pipefail  # not -u: ROS's setup files read unset variables
cd "$(dirname "$0")/.."
source ./setup.bash
# Keep the user's ~/.ros untouched.
ROS_HOME="$(mktemp -d)"
export ROS_HOME
trap 'rm -rf "$ROS_HOME"' EXIT
status=0
python3 -m pytest -p no:cacheprovider --junitxml=build/tests.xml "$@" || status=$?
python3 tools/count_tests.py build/tests.xml
exit "$status"
