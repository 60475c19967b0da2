# Sourced by the scripts that launch on this machine: environment and ROS master.
source ./setup.bash
# Use another port if a system is running on the usual one.
ROS_MASTER_URI="http://localhost:$(python3 tools/free_port.py 11311)"
export ROS_MASTER_URI ROSCONSOLE_FORMAT='${node}: ${message}' PYTHONUNBUFFERED=1
# The host name may not resolve, for example in a container.
[ -n "${ROS_IP:-}${ROS_HOSTNAME:-}" ] || export ROS_HOSTNAME=localhost
echo "to inspect the running system:  source setup.bash; export ROS_MASTER_URI=$ROS_MASTER_URI"
