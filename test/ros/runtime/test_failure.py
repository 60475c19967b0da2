"""The failure parameter, and what the monitor logs about it; no ROS master."""

import runpy
from types import SimpleNamespace
from unittest.mock import Mock

import pytest
import rospy

from embodied_active_learning.errors import RunFailedError
from embodied_active_learning.ros.runtime import failure
from embodied_active_learning.ros.runtime.failure import FailureWatch
from launching import ROOT

UNSET = (-1, "not set", 0)
REASON = "/trainer: disk full"


@pytest.fixture
def master(monkeypatch):
    """A master whose parameter is not set, and a watch whose timer does not run."""
    monkeypatch.setattr(failure, "WallTimer", Mock())
    master = Mock()
    master.getParam.return_value = UNSET
    monkeypatch.setattr(failure, "master_proxy", lambda: master)
    return master


def test_reason_is_kept_when_master_disappears(master):
    watch = FailureWatch()
    assert watch.read_reason() == ""
    watch.check()
    master.getParam.return_value = (1, "", REASON)
    assert watch.read_reason() == REASON
    master.getParam.side_effect = ConnectionRefusedError
    assert watch.read_reason() == REASON
    with pytest.raises(RunFailedError, match=REASON):
        watch.check()


@pytest.mark.parametrize(("parameter", "expected"), [((1, "", REASON), "failed at step 5"), (UNSET, "ended at step 5")])
def test_monitor_distinguishes_reported_failure(master, monkeypatch, parameter, expected):
    """Also if the launch ends the monitor before its timer has read the parameter."""
    master.getParam.return_value = parameter
    monitor = runpy.run_path(str(ROOT / "nodes" / "monitor"))["Monitor"]
    lines = []
    monkeypatch.setattr(rospy, "loginfo", lambda text, *values: lines.append(text % values))
    for name in ("Session", "conclude_launch"):
        monkeypatch.setitem(monitor.record_early_end.__globals__, name, Mock())
    status = SimpleNamespace(session="run", observations=5, steps=24)
    monitor.record_early_end(SimpleNamespace(_status=status, _started_at=0.0), FailureWatch())
    assert [line.partition(" of ")[0] for line in lines] == [expected]
