# To be sourced: the environment of launches that run by themselves on this machine.
source ./setup.bash
# A master of its own where the usual port is taken, so that nobody's running system is disturbed.
ROS_MASTER_URI="http://localhost:$(python3 tools/free_port.py 11311)"
export ROS_MASTER_URI ROSCONSOLE_FORMAT='${node}: ${message}' PYTHONUNBUFFERED=1
# The host's own name may not resolve, in a container say; all nodes are here.
[ -n "${ROS_IP:-}${ROS_HOSTNAME:-}" ] || export ROS_HOSTNAME=localhost
echo "to look at the running system:  source setup.bash; export ROS_MASTER_URI=$ROS_MASTER_URI"
