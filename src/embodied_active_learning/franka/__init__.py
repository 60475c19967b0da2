"""A real Panda behind franka_ros: all that decides how it moves, without ROS."""
