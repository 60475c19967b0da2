"""Settings of all tests."""

from hypothesis import settings

settings.register_profile("untimed", deadline=None)  # no test depends on timing
settings.load_profile("untimed")
