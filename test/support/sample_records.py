"""Records of runs that were never made."""

from __future__ import annotations

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.session.summary import Summary
from embodied_active_learning.session.tables import COLUMNS
from embodied_active_learning.sweep.run_records import Record


def make_record(name, explorer, level, steps=100, seed=0):
    """A record whose every column rises to a level."""
    tables = {}
    for table, columns in COLUMNS.items():
        axis = np.arange(1.0, steps + 1.0)
        tables[table] = dict.fromkeys(columns, level * axis / steps)
        tables[table][columns[0]] = axis
    config = Config.from_dict({"exploration": {"explorer": explorer, "seed": seed}})
    return Record(name, explorer, config, Summary(True, steps, steps, 1.0), tables)
