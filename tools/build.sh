#!/usr/bin/env bash
# Builds messages and the devel space in build/ with the Python interpreter of .venv.
set -eo pipefail  # not -u: ROS's setup files read unset variables
cd "$(dirname "$0")/.."
if [ -f /opt/ros/noetic/setup.bash ]; then
    source /opt/ros/noetic/setup.bash
fi
mkdir -p build
cmake -S . -B build -DPYTHON_EXECUTABLE="$PWD/.venv/bin/python3" \
    -DCATKIN_ENABLE_TESTING=OFF > build/build.log 2>&1 \
    && make -C build >> build/build.log 2>&1 \
    || { cat build/build.log >&2; exit 1; }
source build/devel/setup.bash
.venv/bin/python3 -c \
    "from embodied_active_learning.model.native.library import load_kernels; print(load_kernels().description)"
echo "built: see build/build.log"
