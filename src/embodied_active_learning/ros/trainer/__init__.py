"""Services and status of a TrainingRun, and the client of these services."""
