"""The planner node: trainer client, publishers, pause services and resume."""
