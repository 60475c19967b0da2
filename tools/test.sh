#!/usr/bin/env bash
# Runs the tests and prints their count. The first argument selects them, the others go to pytest:
#   tools/test.sh unit    tests without nodes, in parallel on all cores
#   tools/test.sh all     these, then the tests with nodes, two files at a time
#   tools/test.sh all test/base/test_config.py -k unknown
set -eo pipefail  # not -u: ROS's setup files read unset variables
cd "$(dirname "$0")/.."
source ./setup.bash
# Keep the user's ~/.ros untouched.
ROS_HOME="$(mktemp -d)"
export ROS_HOME
trap 'rm -rf "$ROS_HOME"' EXIT
rm -f build/tests-*.xml
which="$1"
shift
status=0
selected=$#

run_tests() {
    local result=0
    python3 -m pytest -p no:cacheprovider --junitxml="build/tests-$1.xml" "${@:2}" || result=$?
    # The user's selection may lie entirely in the other half.
    if [ "$result" = 5 ] && [ "$selected" -gt 0 ]; then result=0; fi
    if [ "$result" != 0 ]; then status="$result"; fi
}

run_tests unit -m "not ros" -n auto --dist loadfile "$@"
# Each launch has its own master, and its nodes wait for much of the time.
if [ "$which" = all ]; then run_tests nodes -m ros -n 2 --dist loadfile "$@"; fi
python3 tools/count_tests.py build/tests-*.xml
exit "$status"
