#!/usr/bin/env bash
# Installs what the package needs: ROS from system packages, Python packages into .venv.
# PIP_FLAGS is passed to pip, for example for a mirror or a CPU build of torch. The output of apt is in build/install.log.
set -euo pipefail
cd "$(dirname "$0")/.."
source tools/check_path.bash

if [ -f /opt/ros/noetic/setup.bash ]; then
    list=tools/noetic-packages.txt
else
    list=tools/debian-packages.txt
fi

missing=()
while read -r name; do
    dpkg-query --show --showformat='${Status}' "$name" 2>/dev/null | grep -q 'ok installed' || missing+=("$name")
done < "$list"

if [ "${#missing[@]}" -gt 0 ]; then
    sudo=()
    [ "$(id -u)" -eq 0 ] || sudo=(sudo)
    if ! "${sudo[@]}" true; then
        echo "${#missing[@]} system packages are missing, and this account cannot use sudo; ask an administrator to run:" >&2
        echo "    apt-get install --no-install-recommends ${missing[*]}" >&2
        exit 1
    fi
    mkdir -p build
    echo "installing ${#missing[@]} system packages of $list (log: build/install.log)"
    {
        "${sudo[@]}" apt-get update -q &&
            "${sudo[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -q -y --no-install-recommends "${missing[@]}"
    } > build/install.log 2>&1 || {
        tail -n 20 build/install.log >&2
        echo "system packages were not installed: see build/install.log" >&2
        exit 1
    }
fi

# The system's interpreter, because ROS's Python modules are built for it; another python3 may be first on PATH.
[ -x .venv/bin/python3 ] || /usr/bin/python3 -m venv --system-site-packages .venv
echo "installing Python packages into .venv"
# shellcheck disable=SC2086  # PIP_FLAGS holds several words
.venv/bin/python3 -m pip install --quiet --disable-pip-version-check ${PIP_FLAGS:-} -r requirements.txt
touch .venv/installed
