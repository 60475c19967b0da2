#!/usr/bin/env bash
# Installs what the package needs, once: ROS from the system's packages, the rest into .venv.
# PIP_FLAGS is handed to pip, for a mirror or for a CPU build of torch.
set -euo pipefail
cd "$(dirname "$0")/.."

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
    echo "installing ${#missing[@]} system packages of $list"
    "${sudo[@]}" apt-get update -q
    "${sudo[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -q -y --no-install-recommends "${missing[@]}"
fi

# The system's interpreter, whatever python3 is first on PATH: ROS's Python modules are built for it.
[ -x .venv/bin/python3 ] || /usr/bin/python3 -m venv --system-site-packages .venv
echo "installing Python packages into .venv"
# shellcheck disable=SC2086  # PIP_FLAGS holds several words
.venv/bin/python3 -m pip install --quiet --disable-pip-version-check ${PIP_FLAGS:-} -r requirements.txt
touch .venv/installed
