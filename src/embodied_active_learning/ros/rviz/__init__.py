"""Messages for rviz."""
