"""Everything a run leaves on disk: one folder, readable again after any crash."""
