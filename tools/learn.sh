#!/usr/bin/env bash
# Learns one world in PyBullet, headless. Exit status: 0 if the run has finished.
# Arguments go to learn.launch; session and session_root are required: tools/learn.sh session:=a session_root:=/tmp/b
set -eo pipefail  # not -u: ROS's setup files read unset variables
cd "$(dirname "$0")/.."
source tools/local_master.bash

for argument in "$@"; do
    case "$argument" in
        session:=*) session="${argument#session:=}" ;;
        session_root:=*) root="${argument#session_root:=}" ;;
    esac
done

roslaunch embodied_active_learning learn.launch "$@"

# roslaunch exits 0 even if a node has died, so the exit status comes from the files of the session.
exec python3 tools/check_session.py learned "$root/$session"
