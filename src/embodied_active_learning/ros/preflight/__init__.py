"""Checks of computer, robot, camera and ROS graph before a run."""
