"""Record, read and convert ROS bags."""
