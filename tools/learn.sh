#!/usr/bin/env bash
# Learns one world in PyBullet, headless, and ends with a truthful exit status.
# Arguments go to learn.launch; session and session_root are needed: tools/learn.sh session:=a session_root:=/tmp/b
set -eo pipefail  # not -u: ROS's own set-up files read variables that are not set
cd "$(dirname "$0")/.."
source tools/local_master.bash

for argument in "$@"; do
    case "$argument" in
        session:=*) session="${argument#session:=}" ;;
        session_root:=*) root="${argument#session_root:=}" ;;
    esac
done

roslaunch embodied_active_learning learn.launch "$@"

# roslaunch exits 0 even when a node has died, so the run's own last file has the last word.
exec python3 tools/check_session.py learned "$root/$session"
