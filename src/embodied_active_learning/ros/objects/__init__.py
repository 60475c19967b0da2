"""ROS side of fingerprinting and identification."""
