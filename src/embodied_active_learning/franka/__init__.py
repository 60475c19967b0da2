"""Motion of a real Panda under franka_ros, without ROS: set-points, readiness and the camera's mount."""
