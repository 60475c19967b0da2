#!/usr/bin/env bash
# Builds the API pages of the library with pdoc: tools/api_docs.sh FOLDER
set -eo pipefail  # not -u: ROS's setup files read unset variables
folder="$(realpath -m -- "${1:?give the folder for the pages}")"
cd "$(dirname "$0")/.."
source ./setup.bash
# Modules that cannot be imported here (franka_msgs is not installed everywhere) and generated messages have no page.
excluded=('!embodied_active_learning.msg' '!embodied_active_learning.srv')
python3 -c 'import franka_msgs' 2>/dev/null || excluded+=('!embodied_active_learning.ros.arm.franka_.*')
# Some libraries start programs on import, which pdoc suppresses by default. It warns of annotations inherited from
# another module; a module that cannot be imported is an error.
PDOC_ALLOW_EXEC=1 python3 -W ignore::UserWarning -m pdoc --docformat google --output-directory "$folder" embodied_active_learning "${excluded[@]}"
echo "API pages: $folder/index.html"
