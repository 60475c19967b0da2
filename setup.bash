# Source this in bash or zsh: sets up ROS, this package and its virtual environment. Workspaces sourced before remain.
if [ -n "${ZSH_VERSION:-}" ]; then
    eval '_eal_file="${(%):-%x}"'
    _eal_shell=zsh
elif [ -n "${BASH_VERSION:-}" ]; then
    eval '_eal_file="${BASH_SOURCE[0]}"'
    _eal_shell=bash
else
    echo "setup.bash: unknown shell; use bash or zsh" >&2
    return 1
fi
_eal_root="$(cd -- "$(dirname -- "$_eal_file")" > /dev/null && pwd)"
_eal_built="$(sed -n 's/^CMAKE_HOME_DIRECTORY:INTERNAL=//p' "$_eal_root/build/CMakeCache.txt" 2> /dev/null)"
if [ ! -f "$_eal_root/build/devel/setup.$_eal_shell" ] || [ -z "$_eal_built" ]; then
    echo "setup.bash: the package is not built; run 'make' in $_eal_root" >&2
elif ! [ "$_eal_built" -ef "$_eal_root" ]; then
    echo "setup.bash: the package was built in $_eal_built, but is now in $_eal_root; run 'make' there" >&2
else
    case $- in
        *u*) _eal_nounset=1; set +u ;;  # ROS's setup files read unset variables
        *) _eal_nounset= ;;
    esac
    case ":${CMAKE_PREFIX_PATH:-}:" in
        *:/opt/ros/noetic:*) ;;
        *) if [ -f /opt/ros/noetic/setup.$_eal_shell ]; then . /opt/ros/noetic/setup.$_eal_shell --extend; fi ;;
    esac
    . "$_eal_root/build/devel/setup.$_eal_shell" --extend
    export VIRTUAL_ENV="$_eal_root/.venv"
    case ":$PATH:" in
        ":$VIRTUAL_ENV/bin:"*) ;;
        *) export PATH="$VIRTUAL_ENV/bin:$PATH" ;;
    esac
    export ROS_MASTER_URI="${ROS_MASTER_URI:-http://localhost:11311}"  # not set by Debian's ROS
    [ -z "$_eal_nounset" ] || set -u
    unset _eal_file _eal_shell _eal_root _eal_built _eal_nounset
    return 0
fi
unset _eal_file _eal_shell _eal_root _eal_built
return 1
