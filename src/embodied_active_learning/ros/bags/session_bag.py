"""The bag of a running session: recording stops when the disk is full, and the run continues."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Dict

import genpy
import rospy

from embodied_active_learning.config import Config
from embodied_active_learning.errors import BagError, SessionError
from embodied_active_learning.ros.bags.writer import BagWriter
from embodied_active_learning.session.atomic import make_folder
from embodied_active_learning.session.disk import check_space, folder_size, free_bytes
from embodied_active_learning.session.paths import SessionPaths


class SessionBag:
    """A new bag in a session's folder; thread-safe."""

    def __init__(self, config: Config, session: Path) -> None:
        """Create the bag. Raises BagError or SessionError if that is impossible."""
        self._config = config
        self._session = session
        self._stopping = threading.Lock()
        self.stopped = ""
        """Reason why recording stopped early; empty while it works."""
        folder = SessionPaths(session).bags
        self._require_space()
        make_folder(folder)
        self._writer = BagWriter(_new_path(folder))

    @property
    def path(self) -> Path:
        """Path of the closed bag."""
        return self._writer.path

    def write(self, name: str, message: genpy.Message, latched: bool = False) -> None:
        """Append a message published now on a topic."""
        try:
            self._writer.write(rospy.resolve_name(name), message, rospy.Time.now(), latched)
        except BagError as error:
            self._stop(str(error))

    def check_disk(self) -> None:
        """Stop recording if the disk has too little space for the rest of the run."""
        try:
            self._require_space()
        except SessionError as error:
            self._stop(str(error))

    def close(self) -> None:
        """Write the bag's index and rename it to its final name."""
        try:
            self._writer.close()
        except BagError as error:
            rospy.logerr("%s", error)

    def values(self) -> Dict[str, object]:
        """Return values for /diagnostics."""
        return {
            "bag": str(self.path),
            "messages": self._writer.messages,
            "size [MB]": round(self._writer.size / 1e6, 2),
            "disk free [GB]": round(free_bytes(self._session) / 1e9, 2),
        }

    def _require_space(self) -> None:
        check_space(self._session, self._config, folder_size(self._session))

    def _stop(self, reason: str) -> None:
        with self._stopping:
            if self.stopped:
                return
            self.stopped = reason
        rospy.logerr("recording stopped, the run continues: %s", reason)
        self.close()


def _new_path(folder: Path) -> Path:
    """Return an unused name made from the time, so that the bags of a resumed run sort by name too."""
    while True:
        path = folder / f"{time.strftime('%Y%m%d-%H%M%S')}.bag"
        if not list(folder.glob(f"{path.name}*")):
            return path
        time.sleep(0.1)
