#!/usr/bin/env bash
# Makes the bag that comes with the package anew, by a simulated run of a minute: tools/make_bag.sh FILE.bag
# The same machine makes the same bag again, but for settings that have come since.
set -eo pipefail  # not -u: ROS's own set-up files read variables that are not set
bag="$(realpath -- "${1:?give the path of the bag to be written, ending with .bag}")"
cd "$(dirname "$0")/.."
root="$(mktemp -d)"
trap 'rm -rf "$root"' EXIT
tools/learn.sh profile:=bags/diagonal-small.yaml session:=small "session_root:=$root"
source ./setup.bash
rosrun embodied_active_learning session_to_bag small "$bag" --root "$root" --compression bz2
