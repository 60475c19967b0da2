"""Stored configurations of older versions are read, or refused by version."""

import pytest

from embodied_active_learning.config import Config, load_profile
from embodied_active_learning.config_versions import CONFIG_VERSION
from embodied_active_learning.errors import ConfigError


def test_renamed_keys_of_an_older_version_are_read():
    old = {"identification": {"mismatch_limit": 0.07, "min_rise": 0.02, "views": 20}}
    assert Config.from_stored(old, 2).identification.views == 20
    assert "mismatch_limit" in old["identification"], "the argument is not modified"


def test_removed_keys_of_an_older_version_are_ignored():
    old = {"identification": {"residual_limit": 0.07, "min_views": 5, "separation": 0.05}}
    assert Config.from_stored(old, 3).identification.separation == 0.05


def test_removed_threshold_of_active_units_is_ignored():
    stored = {"training": {"active_unit_threshold": 0.02, "batch_size": 32}}
    assert Config.from_stored(stored, 4).training.batch_size == 32


def test_trials_of_an_older_version_move_to_the_fingerprint(tmp_path):
    values = {"identification": {"trials": 99}}
    assert Config.from_stored(values, 5).fingerprint.trials == 99
    profile = tmp_path / "old.yaml"
    profile.write_text("identification: {trials: 99}\n")
    assert load_profile(profile) == {"identification": {}, "fingerprint": {"trials": 99}}


def test_new_key_wins_over_the_old_one():
    values = {"identification": {"trials": 39}, "fingerprint": {"trials": 99}}
    assert Config.from_stored(values, 5).fingerprint.trials == 99


def test_invalid_section_is_refused_also_if_a_key_moves_there():
    with pytest.raises(ConfigError, match="fingerprint"):
        Config.from_stored({"identification": {"trials": 39}, "fingerprint": 3}, 5)


def test_current_version_refuses_old_keys():
    with pytest.raises(ConfigError, match="unknown key identification/min_rise"):
        Config.from_stored({"identification": {"min_rise": 0.02}}, CONFIG_VERSION)


@pytest.mark.parametrize("version", [0, CONFIG_VERSION + 1])
def test_unknown_version_is_refused_with_the_remedy(version):
    with pytest.raises(ConfigError, match=rf"version {version} .* is unknown.*install the version"):
        Config.from_stored(Config().to_dict(), version)
