#!/usr/bin/env bash
# Records the example bag again, in a simulated run of a minute: tools/make_bag.sh FILE.bag
# The result is the same on the same machine, except for settings added since.
set -eo pipefail  # not -u: ROS's setup files read unset variables
bag="$(realpath -- "${1:?give the path of the new bag, ending with .bag}")"
cd "$(dirname "$0")/.."
root="$(mktemp -d)"
trap 'rm -rf "$root"' EXIT
tools/learn.sh profile:=bags/diagonal-small.yaml session:=small "session_root:=$root"
source ./setup.bash
rosrun embodied_active_learning session_to_bag small "$bag" --root "$root" --compression bz2
