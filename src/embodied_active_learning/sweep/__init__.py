"""Many runs from one specification, their results, and comparisons of them, without ROS."""
