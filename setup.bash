# Source this: a shell in which roslaunch, rosservice, rosrun and rviz work with this package.
# It puts together ROS, the virtual environment and the built workspace, whatever python3 is first on PATH.
_eal_root="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
if [ ! -f "$_eal_root/build/devel/setup.bash" ]; then
    echo "nothing is built yet: run 'make' in $_eal_root first" >&2
    unset _eal_root
    return 1
fi
if [ -f /opt/ros/noetic/setup.bash ]; then
    source /opt/ros/noetic/setup.bash
fi
source "$_eal_root/build/devel/setup.bash"
export VIRTUAL_ENV="$_eal_root/.venv"
case ":$PATH:" in
    ":$VIRTUAL_ENV/bin:"*) ;;
    *) export PATH="$VIRTUAL_ENV/bin:$PATH" ;;
esac
# Debian's ROS has no environment of its own.
export ROS_MASTER_URI="${ROS_MASTER_URI:-http://localhost:11311}"
unset _eal_root
