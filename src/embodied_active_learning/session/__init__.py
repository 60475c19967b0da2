"""The session folder: everything a run stores, readable again after a crash at any moment."""
