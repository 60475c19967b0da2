"""A stand-in for the paper's velocity service, for tests."""
