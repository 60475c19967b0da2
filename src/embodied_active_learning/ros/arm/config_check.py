"""Whether the system that drives a real arm was configured for that arm."""

from __future__ import annotations

from typing import Any, Optional

import rospy

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CommandError, ConfigError
from embodied_active_learning.ros import names
from embodied_active_learning.ros.runtime.timers import WallTimer

PERIOD = 2.0
"""Wall seconds between two looks at the system's configuration."""
SHARED = ("workspace", "camera", "arm", "franka")
"""Sections that describe the arm and what its camera sees: they must be the same for whoever drives it."""


def require_matching_config(own: Config, values: Any) -> None:
    """Raise CommandError where an arm's configuration disagrees with the system's, as it is on the master."""
    try:
        theirs = Config.from_dict(values).to_dict()
    except ConfigError as error:
        raise CommandError(
            f"the system's configuration is none ({error}): start it from one of the package's launch files"
        ) from error
    ours = own.to_dict()
    for section in SHARED:
        for key, value in ours[section].items():
            if theirs[section][key] != value:
                raise CommandError(
                    f"{section}/{key} is {theirs[section][key]!r} in the system's configuration, and {value!r} in "
                    "the arm's: give both launch files the same robot_profile and profile"
                )


class ConfigCheck:
    """Compares the arm's own configuration with the system's, on the master.

    An arm that was started by a launch file of its own, on another computer say, has its configuration from there, and
    the planner has it from learn.launch. With another workspace or camera mount, what is learned would be described
    wrongly; with other limits, planned wrongly.
    """

    def __init__(self, config: Config) -> None:
        self._own = config
        self._disagreement: Optional[CommandError] = None
        self.look()
        WallTimer(PERIOD, self.look)

    @property
    def difference(self) -> str:
        """What the two do not agree about, in words; empty when they agree."""
        return "" if self._disagreement is None else str(self._disagreement)

    def require(self) -> None:
        """Raise CommandError when they do not agree."""
        if self._disagreement is not None:
            raise self._disagreement

    def look(self) -> None:
        """Compare them now."""
        before = self.difference
        values = rospy.get_param(names.CONFIG_PARAMETER, None)
        try:
            if values is not None:
                require_matching_config(self._own, values)
            self._disagreement = None
        except CommandError as error:
            self._disagreement = error
            if str(error) != before:
                rospy.logerr("this system is not let drive the arm: %s", error)
