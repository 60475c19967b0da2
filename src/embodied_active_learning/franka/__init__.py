"""Motion of a real Panda without ROS: set-points, readiness and the camera's mount."""
