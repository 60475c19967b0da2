"""Fingerprinting: sessions without a model or without objects, and the settings that are used."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from embodied_active_learning.config import Config, FingerprintConfig
from embodied_active_learning.errors import SessionError
from embodied_active_learning.pipeline.fingerprinting import FingerprintRun
from embodied_active_learning.session.session import Session
from painted_table import Thing, learn


def test_fingerprinting_without_model_raises(tmp_path):
    config = Config.from_dict({"session": {"name": "early", "root": str(tmp_path)}})
    match = r"session early has no trained model yet: .* 64 observations \(training/first_update_at\); retry later"
    with Session.open_for_writing(config), pytest.raises(SessionError, match=match):
        FingerprintRun(tmp_path / "early")


@pytest.mark.parametrize("flat", [True, False])
def test_summary_of_flat_entropy_names_remedy(flat):
    run = FingerprintRun.__new__(FingerprintRun)
    run._config = Config()
    run.clustering = SimpleNamespace(
        flat=flat, contrast=1.3, clusters=(), unreachable=(), visible=SimpleNamespace(prints=())
    )
    flat_summary = "no objects found: the predicted standard deviation varies by 1.3x over the workspace, less than"
    assert run.summary.startswith(flat_summary) is flat
    assert run.summary.startswith("0 objects") is not flat


def test_summary_counts_prints_that_clustering_leaves_out():
    run = FingerprintRun.__new__(FingerprintRun)
    run.clustering = SimpleNamespace(flat=False, contrast=3.0, clusters=(), unreachable=())
    run.clustering.visible = SimpleNamespace(prints=(None, None))
    run._config = Config.from_dict({"fingerprint": {"clustering": "table"}})
    assert run.summary.endswith("; skipped 2 in the plane of the table (to keep them: fingerprint/prints)")
    run._config = Config.from_dict({"fingerprint": {"clustering": "camera"}})
    assert "skipped" not in run.summary


def test_given_trials_are_simulated_instead_of_the_sessions(caplog):
    caplog.set_level("INFO", "embodied_active_learning")
    learned = learn((Thing(0, (0.40, -0.07, 0.6)),), (0.36, 0.12))
    run = FingerprintRun.__new__(FingerprintRun)
    run._config = replace(learned.config, fingerprint=FingerprintConfig(trials=5))
    found = run._calibrated(learned.fingerprints[0], learned.fingerprints)
    assert len(found.calibration.true) == len(found.calibration.false) == 5
    assert "computing the limits of object-1 (1 of 1)" in caplog.text
