#!/usr/bin/env bash
# Builds messages and the devel space in build/, with the virtual environment's interpreter.
set -euo pipefail
cd "$(dirname "$0")/.."
if [ -f /opt/ros/noetic/setup.bash ]; then
    set +u
    source /opt/ros/noetic/setup.bash
    set -u
fi
cmake -S . -B build -DPYTHON_EXECUTABLE="$PWD/.venv/bin/python3" > build.log 2>&1 \
    && make -C build >> build.log 2>&1 \
    || { cat build.log >&2; exit 1; }
mkdir -p build && mv build.log build/build.log
echo "built: see build/build.log"
