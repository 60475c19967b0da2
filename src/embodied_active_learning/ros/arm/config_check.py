"""Config check: a real arm accepts commands only from a system that was configured for it."""

from __future__ import annotations

from typing import Any, Optional

import rospy

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CommandError, ConfigError
from embodied_active_learning.ros import names
from embodied_active_learning.ros.runtime.timers import WallTimer

PERIOD = 2.0
"""Wall seconds between two checks of the system's configuration."""
SHARED = ("workspace", "camera", "arm", "franka")
"""Sections that describe the arm and its camera: they must be the same for the arm and for its commander."""
COMMANDER_ONLY = ("arm/retries",)
"""Settings in these sections that the arm's node does not read."""


def require_matching_config(own: Config, values: Any) -> None:
    """Raise CommandError if an arm's configuration differs from the system's on the parameter server (values)."""
    try:
        theirs = Config.from_dict(values).to_dict()
    except ConfigError as error:
        raise CommandError(
            f"invalid system configuration: {error}; start the system from one of the package's launch files"
        ) from error
    ours = own.to_dict()
    for section in SHARED:
        for key, value in ours[section].items():
            if theirs[section][key] != value and f"{section}/{key}" not in COMMANDER_ONLY:
                raise CommandError(
                    f"configuration mismatch: {section}/{key} is {theirs[section][key]!r} in the system and {value!r} "
                    "in the arm's node; give both launch files the same robot_profile and profile"
                )


class ConfigCheck:
    """Compares the arm node's configuration with the system's, periodically.

    An arm started by its own launch file, for instance on another computer, has its own configuration. With a different
    workspace or camera mount the observations would be labelled wrongly; with different limits the plan would be wrong.
    """

    def __init__(self, config: Config) -> None:
        self._own = config
        self._mismatch: Optional[CommandError] = None
        self.update()
        WallTimer(PERIOD, self.update)

    @property
    def mismatch(self) -> str:
        """The first difference; empty when the configurations match."""
        return "" if self._mismatch is None else str(self._mismatch)

    def require(self) -> None:
        """Raise CommandError if the configurations differ."""
        if self._mismatch is not None:
            raise self._mismatch

    def update(self) -> None:
        """Compare the configurations now."""
        values = rospy.get_param(names.CONFIG_PARAMETER, None)
        try:
            if values is not None:
                require_matching_config(self._own, values)
            self._mismatch = None
        except CommandError as error:
            self._mismatch = error
