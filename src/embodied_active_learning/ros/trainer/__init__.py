"""The trainer node: services and status of a TrainingRun."""
