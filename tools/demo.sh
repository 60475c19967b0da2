#!/usr/bin/env bash
# Learns one world in PyBullet, fingerprints its objects, and identifies them in another world; headless.
# Arguments go to learn.launch (tools/demo.sh world:=right seed:=2 rviz:=true), except for those of the last part:
# identify_world:=stars_ducks images:=1000. Exit status: 0 if all three parts have finished.
set -eo pipefail  # not -u: ROS's setup files read unset variables
cd "$(dirname "$0")/.."

root="${HOME}/.ros/embodied_active_learning"
session="demo-$(date +%Y%m%d-%H%M%S)-$$"
profile=demo
identify_world=other_table
images=1000
learn=()
for argument in "$@"; do
    case "$argument" in
        session:=*) session="${argument#session:=}" ;;
        session_root:=*) root="${argument#session_root:=}" ;;
        identify_world:=*) identify_world="${argument#identify_world:=}" ;;
        images:=*) images="${argument#images:=}" ;;
        profile:=*) profile="${argument#profile:=}" ;;
        *) learn+=("$argument") ;;
    esac
done
root="${root/#\~/$HOME}"
found="${session:0:60}-id"  # at most 64 characters

echo "1 of 3: learning"
tools/learn.sh "profile:=$profile" "session:=$session" "session_root:=$root" steps:=auto "${learn[@]}"

source tools/local_master.bash
echo "2 of 3: fingerprinting"
roslaunch embodied_active_learning fingerprint.launch "session:=$session" "session_root:=$root"
# roslaunch exits 0 even if a node has died, so the exit status comes from the files of each part.
python3 tools/check_session.py fingerprinted "$root/$session"

echo "3 of 3: identifying in $identify_world"
roslaunch embodied_active_learning identify.launch "profile:=$profile" "sessions:=$session" "world:=$identify_world" \
    "images:=$images" explorer:=active "session:=$found" "session_root:=$root" name:=demo
result="$(python3 tools/check_session.py identified "$root/$found" demo)"
cat << RESULT

================================ result ================================
learned in $root/$session
$result

what to try next (source setup.bash):
  other worlds:      roslaunch embodied_active_learning identify.launch sessions:=$session world:=stars_ducks profile:=$profile \\
                         explorer:=active images:=$images session_root:=$root
  drive to the found objects and take a picture of each:  add visit:=true
  watch it in rviz:  add rviz:=true
  your own world:    docs/worlds.md        a real Panda: docs/panda.md
RESULT
