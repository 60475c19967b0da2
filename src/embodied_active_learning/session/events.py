"""Write the tables of a session as TensorBoard events, also while it is being learned, until Ctrl-C.

    python3 -m embodied_active_learning.session.events ~/.ros/embodied_active_learning/NAME

Needs tensorboardX (`pip install tensorboardX`). The events are written to tensorboard/ in the session's folder.
"""

from __future__ import annotations

import math
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, Dict

from embodied_active_learning.errors import EmbodiedActiveLearningError, MissingPackageError
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.tables import COLUMNS

PERIOD = 5.0  # s


def write_events(session: Session, writer: Any, written: Dict[str, int]) -> None:
    """Write the new rows of all tables as scalars TABLE/COLUMN over steps or updates.

    Args:
        session: A session, also one that is being learned.
        writer: A SummaryWriter of tensorboardX.
        written: Number of rows written of each table, which is updated.
    """
    for table, (axis, *names) in COLUMNS.items():
        columns = session.read_table(table)
        for row in range(written.get(table, 0), len(columns[axis])):
            for name in names:
                if math.isfinite(columns[name][row]):
                    writer.add_scalar(f"{table}/{name}", columns[name][row], int(columns[axis][row]))
        written[table] = len(columns[axis])


def main(folder: Path) -> None:
    """Write events of a session's folder until interrupted. Raises SessionError or MissingPackageError."""
    session = Session.open_read_only(folder)
    written: Dict[str, int] = {}
    try:
        import tensorboardX  # noqa: PLC0415 - optional
    except ImportError as error:
        raise MissingPackageError("tensorboardX is not installed: pip install tensorboardX") from error
    with suppress(KeyboardInterrupt), tensorboardX.SummaryWriter(str(folder / "tensorboard"), flush_secs=1) as writer:
        while True:
            write_events(session, writer, written)
            time.sleep(PERIOD)


if __name__ == "__main__":
    try:
        main(Path(sys.argv[1]))
    except (EmbodiedActiveLearningError, IndexError) as error:
        sys.exit(f"{error}\nusage: python3 -m embodied_active_learning.session.events SESSION")
