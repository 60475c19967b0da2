#!/usr/bin/env bash
# Builds messages, kernels and the devel space in build/ with the Python interpreter of .venv.
set -eo pipefail  # not -u: ROS's setup files read unset variables
cd "$(dirname "$0")/.."
source tools/check_path.bash
case ":$CMAKE_PREFIX_PATH:" in
    *:/opt/ros/noetic:*) ;;
    *) if [ -f /opt/ros/noetic/setup.bash ]; then source /opt/ros/noetic/setup.bash; fi ;;
esac
mkdir -p build
# CMake's cache and the devel space contain absolute paths: a moved checkout is built again.
if [ -f build/CMakeCache.txt ] && ! [ "$(sed -n 's/^CMAKE_HOME_DIRECTORY:INTERNAL=//p' build/CMakeCache.txt)" -ef . ]; then
    find build -mindepth 1 -maxdepth 1 ! -name install.log -exec rm -rf {} +
fi
cmake -S . -B build -DPYTHON_EXECUTABLE="$PWD/.venv/bin/python3" \
    -DCATKIN_ENABLE_TESTING=OFF > build/build.log 2>&1 \
    && make -C build >> build/build.log 2>&1 \
    || { cat build/build.log >&2; exit 1; }
source build/devel/setup.bash --extend
.venv/bin/python3 -c \
    "from embodied_active_learning.model.native.library import load_kernels; print(load_kernels().description)"
echo "built: see build/build.log"
