"""A simulated franka_ros, for tests and for trials without a robot. See README.md."""
