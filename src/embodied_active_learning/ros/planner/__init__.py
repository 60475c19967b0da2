"""The planner node: publishers, pause services and resume."""
