"""ROS layer of the nodes: the only part of the library that imports rospy."""
