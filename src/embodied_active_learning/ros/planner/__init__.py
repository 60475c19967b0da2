"""The planner node: trainer client, publishers, pause and resume."""
