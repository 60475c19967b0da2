"""A stand-in for franka_ros, for tests and for trying things out without a robot. See README.md."""
