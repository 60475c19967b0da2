#!/usr/bin/env bash
# Learns one world in PyBullet with the demo profile, headless, and ends with a truthful exit status.
# Arguments go to learn.launch: tools/demo.sh world:=right seed:=2 rviz:=true
set -eo pipefail  # not -u: ROS's own set-up files read variables that are not set
cd "$(dirname "$0")/.."
source ./setup.bash

root="${HOME}/.ros/embodied_active_learning"
session="demo-$(date +%Y%m%d-%H%M%S)-$$"
for argument in "$@"; do
    case "$argument" in
        session:=*) session="${argument#session:=}" ;;
        session_root:=*) root="${argument#session_root:=}" ;;
    esac
done
root="${root/#\~/$HOME}"

# A master of its own where the usual port is taken, so that the demo disturbs nobody's running system.
ROS_MASTER_URI="http://localhost:$(python3 tools/free_port.py 11311)"
export ROS_MASTER_URI ROSCONSOLE_FORMAT='${node}: ${message}' PYTHONUNBUFFERED=1
# The host's own name may not resolve, in a container say; all nodes are here.
[ -n "${ROS_IP:-}${ROS_HOSTNAME:-}" ] || export ROS_HOSTNAME=localhost
echo "to look at the running system:  source setup.bash; export ROS_MASTER_URI=$ROS_MASTER_URI"

roslaunch embodied_active_learning learn.launch profile:=demo "session:=$session" "session_root:=$root" "$@"

# roslaunch exits 0 even when a node has died, so the run's own last file has the last word.
exec python3 tools/check_session.py "$root/$session"
