"""Settings of all tests."""

import copy
import functools
import os

import pytest
from hypothesis import settings

from embodied_active_learning import files

for _profile, _examples in (("quick", 30), ("thorough", 500)):
    settings.register_profile(_profile, deadline=None, max_examples=_examples)  # no test depends on timing
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "quick"))


@pytest.fixture(scope="session", autouse=True)
def _equal_yaml_is_parsed_once():
    """Parse each text of a YAML file once, because many tests open one session repeatedly."""
    parse = functools.lru_cache(maxsize=256)(files.parse_yaml)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(files, "parse_yaml", lambda text: copy.deepcopy(parse(text)))
        yield
