"""What the library says with Python's logging, told as a node tells things: on the terminal and on /rosout.

rospy would write it to the node's log file only, where nobody sees that a checkpoint was refused.
"""

from __future__ import annotations

import logging

import rospy

LIBRARY = "embodied_active_learning"


class _RosHandler(logging.Handler):
    """Hands records over to rospy's log, at their level."""

    def emit(self, record: logging.LogRecord) -> None:
        if record.levelno >= logging.ERROR:
            say = rospy.logerr
        elif record.levelno >= logging.WARNING:
            say = rospy.logwarn
        else:
            say = rospy.loginfo
        say("%s", record.getMessage())


def show_library_log() -> None:
    """From now on tell what the library says, from its level INFO on, to whoever follows this node."""
    logger = logging.getLogger(LIBRARY)
    logger.handlers = [_RosHandler(logging.INFO)]
    logger.propagate = False
    logger.setLevel(logging.INFO)
