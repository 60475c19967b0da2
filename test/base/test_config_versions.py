"""Stored configurations of older versions are read, or refused by version."""

import pytest

from embodied_active_learning.config import Config
from embodied_active_learning.config_versions import CONFIG_VERSION, stored_config
from embodied_active_learning.errors import ConfigError


def test_renamed_keys_of_an_older_version_are_read():
    old = {"identification": {"mismatch_limit": 0.07, "min_rise": 0.02, "views": 20}}
    assert stored_config(old, 2).identification.views == 20
    assert "mismatch_limit" in old["identification"], "the argument is not modified"


def test_removed_keys_of_an_older_version_are_ignored():
    old = {"identification": {"residual_limit": 0.07, "min_views": 5, "separation": 0.05}}
    assert stored_config(old, 3).identification.separation == 0.05


def test_removed_threshold_of_active_units_is_ignored():
    stored = {"training": {"active_unit_threshold": 0.02, "batch_size": 32}}
    assert stored_config(stored, 4).training.batch_size == 32


def test_current_version_refuses_old_keys():
    with pytest.raises(ConfigError, match="unknown key identification/min_rise"):
        stored_config({"identification": {"min_rise": 0.02}}, CONFIG_VERSION)


@pytest.mark.parametrize("version", [0, CONFIG_VERSION + 1])
def test_unknown_version_is_refused_with_the_remedy(version):
    with pytest.raises(ConfigError, match=rf"version {version} .* is unknown.*install the version"):
        stored_config(Config().to_dict(), version)
