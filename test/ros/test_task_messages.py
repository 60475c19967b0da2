"""Service and action of the same task have the same fields, which their node fills from one set of values."""

import pytest

from embodied_active_learning import msg, srv


def fields(message):
    return dict(zip(message.__slots__, message._slot_types))


@pytest.mark.parametrize("task", ["CollectFingerprints", "Identify"])
def test_service_and_action_have_the_same_fields(task):
    goal, result = getattr(msg, f"{task}Goal"), getattr(msg, f"{task}Result")
    assert fields(getattr(srv, f"{task}Request")) == fields(goal)
    assert fields(getattr(srv, f"{task}Response")) == {"success": "bool", **fields(result)}
