"""Fingerprinting a session that has nothing to take fingerprints of."""

from types import SimpleNamespace

import pytest

from embodied_active_learning.config import Config
from embodied_active_learning.errors import SessionError
from embodied_active_learning.pipeline.fingerprinting import FingerprintRun
from embodied_active_learning.session.session import Session


def test_a_session_that_has_not_learned_anything_says_when_to_call_again(tmp_path):
    config = Config.from_dict({"session": {"name": "early", "root": str(tmp_path)}})
    match = r"session early has not learned anything yet: .* training/first_update_at \(64\) observations; call again"
    with Session.open_for_writing(config), pytest.raises(SessionError, match=match):
        FingerprintRun(tmp_path / "early")


@pytest.mark.parametrize("flat", [True, False])
def test_a_table_where_nothing_stands_out_says_what_to_do(flat):
    run = FingerprintRun.__new__(FingerprintRun)
    run._config = Config()
    run.clustering = SimpleNamespace(flat=flat, contrast=1.3, clusters=(), unreachable=())
    told = "nothing to find: the predicted standard deviation varies by 1.3x over the workspace, less than"
    assert run.nothing_found.startswith(told) is flat
    assert run.finding.startswith(told) is flat
    assert bool(run.nothing_found) is flat
