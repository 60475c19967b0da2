"""What the nodes share to talk ROS: the only part of the library that imports rospy."""
