#!/usr/bin/env bash
# Runs the tests and prints their count. The first argument selects them, the others go to pytest:
#   tools/test.sh unit    tests without nodes, in parallel on all cores
#   tools/test.sh all     these, beside the tests with nodes, two files at a time
#   tools/test.sh all test/base/test_config.py -k unknown
set -meo pipefail  # -m: a job has its own process group; not -u: ROS's setup files read unset variables
cd "$(dirname "$0")/.."
source ./setup.bash
# Keep the user's ~/.ros untouched.
ROS_HOME="$(mktemp -d)"
export ROS_HOME
trap '{ jobs -p | xargs -rI{} kill -- -{}; } 2> /dev/null || true; rm -rf "$ROS_HOME"' EXIT
rm -f build/tests-*.xml
# A master that runs already would be seen by tests of launch files.
ROS_MASTER_URI="http://localhost:$(python3 tools/free_port.py 11311)"
export ROS_MASTER_URI
# Each process of pytest computes on one core.
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
which="$1"
shift
selected=$#

run_tests() {
    local result=0 name="$1"
    python3 -m pytest -p no:cacheprovider --junitxml="build/tests-$name.xml" --dist loadfile "${@:2}" || result=$?
    # The user's selection may lie entirely in the other half.
    if [ "$result" = 5 ] && [ "$selected" -gt 0 ]; then result=0; fi
    return "$result"
}

status=0
if [ "$which" = all ]; then
    # Each launch has its own master. Its nodes wait for much of the time, which the other tests use.
    log=build/tests-unit.log
    echo "running the tests without nodes at the same time, at low priority: see $log"
    (renice -n 10 "$BASHPID" > /dev/null && run_tests unit -m "not ros" -n auto "$@") > "$log" 2>&1 &
    # Those tests are in one folder, unless the user selects files.
    folder=(test/system)
    for word in "$@"; do if [ -e "${word%%::*}" ]; then folder=(); fi; done
    run_tests nodes -m ros -n 2 "${folder[@]}" "$@" || status=$?
    if [ "$status" = 2 ]; then exit 2; fi  # interrupted, or tests that cannot be imported
    wait $! || status=$?
    cat "$log"
else
    run_tests unit -m "not ros" -n auto "$@" || status=$?
fi
python3 tools/count_tests.py build/tests-*.xml
exit "$status"
