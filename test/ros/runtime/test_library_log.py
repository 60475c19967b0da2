"""The library's warnings reach whoever looks at a node's output."""

import logging

import pytest

from embodied_active_learning.ros.runtime.library_log import LIBRARY, show_library_log


@pytest.fixture
def library():
    logger = logging.getLogger(LIBRARY)
    before = logger.handlers, logger.propagate, logger.level
    show_library_log()
    yield logging.getLogger(f"{LIBRARY}.training_run")
    logger.handlers, logger.propagate = before[:2]
    logger.setLevel(before[2])


@pytest.mark.parametrize("level", [logging.INFO, logging.WARNING, logging.ERROR])
def test_what_the_library_says_is_on_the_log_of_the_node_once_and_at_its_level(library, caplog, level):
    with caplog.at_level(logging.INFO, "rosout"):
        library.log(level, "checkpoint refused: %s, 100 %% damaged", "a")
    assert [(record.name, record.levelno) for record in caplog.records] == [("rosout", level)]
    assert "checkpoint refused: a, 100 % damaged" in caplog.text


def test_what_is_for_developers_only_is_not_told(library, caplog):
    with caplog.at_level(logging.INFO, "rosout"):
        library.debug("a detail")
    assert caplog.records == []


def test_calling_it_again_does_not_tell_things_twice(library, caplog):
    show_library_log()
    with caplog.at_level(logging.INFO, "rosout"):
        library.warning("once")
    assert len(caplog.records) == 1
