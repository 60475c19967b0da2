"""Markers, clouds and paths for rviz."""
