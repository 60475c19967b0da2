"""Log records of the library reach the handlers of rospy."""

import logging

import pytest

from embodied_active_learning.ros.runtime.node import show_library_log


class Records(logging.Handler):
    def __init__(self):
        super().__init__()
        self.lines = []

    def emit(self, record):
        self.lines.append((record.levelno, record.getMessage()))


@pytest.fixture
def rosout():
    """A handler of rospy's log, and the library's log connected to it."""
    library, node, handler = logging.getLogger("embodied_active_learning"), logging.getLogger("rosout"), Records()
    before = library.handlers, library.propagate, library.level
    show_library_log()
    node.addHandler(handler)  # rospy adds handlers at any time
    yield handler
    node.removeHandler(handler)
    library.handlers, library.propagate = before[:2]
    library.setLevel(before[2])


LOG = logging.getLogger("embodied_active_learning.training_run")


@pytest.mark.parametrize("level", [logging.INFO, logging.WARNING, logging.ERROR])
def test_library_records_reach_rosout_at_their_level(rosout, level):
    LOG.log(level, "checkpoint invalid: %s, 100 %% damaged", "a")
    assert rosout.lines == [(level, "checkpoint invalid: a, 100 % damaged")]


def test_library_debug_records_are_dropped(rosout):
    LOG.debug("a detail")
    assert rosout.lines == []


def test_show_library_log_twice_logs_once(rosout):
    show_library_log()
    LOG.warning("once")
    assert len(rosout.lines) == 1
