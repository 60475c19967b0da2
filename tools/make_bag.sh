#!/usr/bin/env bash
# Makes the example bag again, from a simulated run of a minute: tools/make_bag.sh FILE.bag
# The result is the same on the same machine, except for settings added since.
set -eo pipefail  # not -u: ROS's setup files read unset variables
bag="$(realpath -- "${1:?give the path of the new bag, ending with .bag}")"
cd "$(dirname "$0")/.."
root="$(mktemp -d)"
trap 'rm -rf "$root"' EXIT
source ./setup.bash
python3 - "$root" <<'PYTHON'
import sys
import embodied_active_learning as eal

session = eal.learn(eal.load_config("bags/diagonal-small.yaml", session={"name": "small", "root": sys.argv[1]}))
print((session.paths.summary).read_text())
PYTHON
rosrun embodied_active_learning session_to_bag small "$bag" --root "$root" --compression bz2
