"""Fingerprinting: sessions without a model or without objects, and the settings that are used."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from embodied_active_learning.config import Config, FingerprintConfig
from embodied_active_learning.errors import SessionError
from embodied_active_learning.objects.fingerprint import BLANK, OBJECT
from embodied_active_learning.pipeline.fingerprinting import (
    FingerprintRun,
    calibrated,
    describe_clustering,
    describe_unrecognisable,
    describe_weakness,
)
from embodied_active_learning.session.session import Session
from painted_table import Thing, learn


def test_fingerprinting_without_model_raises(tmp_path):
    config = Config.from_dict({"session": {"name": "early", "root": str(tmp_path)}})
    match = r"session early has no trained model yet: .* 64 observations \(training/first_update_at\); retry later"
    with Session.open_for_writing(config), pytest.raises(SessionError, match=match):
        FingerprintRun(tmp_path / "early")


def clustering(**values):
    facts = {"low_contrast": False, "contrast": 1.3, "clusters": (), "unreachable": (), "visible": visible(0)}
    return SimpleNamespace(**{**facts, **values})


def visible(prints):
    return SimpleNamespace(prints=(None,) * prints)


@pytest.mark.parametrize("low_contrast", [True, False])
def test_summary_of_low_contrast_names_remedy(low_contrast):
    summary = describe_clustering(clustering(low_contrast=low_contrast), FingerprintConfig())
    expected = "no objects found: the predicted standard deviation varies by 1.3x over the workspace, less than"
    assert summary.startswith(expected) is low_contrast
    assert summary.startswith("0 objects") is not low_contrast


def test_summary_counts_prints_that_clustering_leaves_out():
    found = clustering(visible=visible(2))
    summary = describe_clustering(found, FingerprintConfig(clustering="table"))
    assert summary.endswith("; skipped 2 in the plane of the table (to keep them: fingerprint/prints)")
    assert "skipped" not in describe_clustering(found, FingerprintConfig(clustering="camera"))


def test_given_trials_are_simulated_instead_of_the_sessions(caplog):
    caplog.set_level("INFO", "embodied_active_learning")
    learned = learn((Thing(0, (0.40, -0.07, 0.6)),), (0.36, 0.12))
    config = replace(learned.config, fingerprint=FingerprintConfig(trials=5))
    found = calibrated(learned.fingerprints[0], learned.fingerprints, config)
    assert len(found.calibration.true) == len(found.calibration.false) == 5
    assert "computing the limits of object-1 (1 of 1)" in caplog.text


def test_objects_without_limits_are_named_as_unrecognisable():
    found = SimpleNamespace(
        fingerprints=[
            SimpleNamespace(name="object-1", kind=OBJECT, calibration=object()),
            SimpleNamespace(name="object-2", kind=OBJECT, calibration=None),
            SimpleNamespace(name="blank-1", kind=BLANK, calibration=None),
        ]
    )
    assert describe_unrecognisable(found).startswith("; object-2 will not be recognised elsewhere")


@pytest.mark.parametrize(
    ("own", "expected"),
    [
        ([0.010], "; the model is weak: the latent removes 0 % of the reconstruction error"),
        ([0.010, 0.002], ""),
        ([], "; the model is not evaluated yet (40 updates)"),
    ],
)
def test_weakness_is_that_of_the_newest_evaluation(own, expected):
    others = np.full(len(own), 0.010)
    weakness = describe_weakness({"mse_own": np.array(own), "mse_shuffled": others, "mse_none": others}, 40)
    assert weakness.startswith(expected)
    assert bool(weakness) == bool(expected)
