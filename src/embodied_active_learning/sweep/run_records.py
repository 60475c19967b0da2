"""Records: what remains of a run when its session is deleted, a folder of some tens of kilobytes with CSV tables.

Records hold no path of a computer, so that they can be committed and compared with those of other computers.
"""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, Iterator, Optional, Tuple

import numpy as np
import torch

from embodied_active_learning import __version__
from embodied_active_learning.config import CONFIG_VERSION, Config
from embodied_active_learning.errors import ConfigError, CorruptFileError
from embodied_active_learning.files import FileReader
from embodied_active_learning.model.native.library import load_kernels, processor_name
from embodied_active_learning.objects.scoring import nearest
from embodied_active_learning.pipeline.fingerprinting import FingerprintRun
from embodied_active_learning.schema import build, to_plain
from embodied_active_learning.session.checksummed_yaml import read_checksummed, write_checksummed
from embodied_active_learning.session.conclusion import summarise
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.summary import Summary, readable_summary
from embodied_active_learning.session.tables import COLUMNS, read_table
from embodied_active_learning.simulation.truth import true_scene
from embodied_active_learning.subsampling import spread_indices
from embodied_active_learning.sweep.csv_files import write_rows

FORMAT = "embodied_active_learning/record"
RECORD_FILE = "record.yaml"
_READER = FileReader(CorruptFileError, "delete the folder, and make the run again")
_ROWS = {"exploration": 300}
_MAX_ROWS = 200
"""Rows of each other table that are kept, evenly spread."""


@dataclass(frozen=True)
class FoundObject:
    """An object that clustering found in the learned model, and the true object nearest to it.

    Attributes:
        kind: object or blank.
        x: Place of the centre [m].
        y: Place of the centre [m].
        nearest: Name of the nearest true object in the world file; empty if the truth is not known. Older records
            have its kind.
        distance: Distance to it [m].
    """

    kind: str
    x: float
    y: float
    nearest: str = ""
    distance: Optional[float] = None


@dataclass(frozen=True)
class _RecordFile:
    """The fields of record.yaml."""

    format: str
    version: int
    package_version: str
    summary: Summary
    config: Dict[str, Any]
    computer: str = ""
    variant: str = ""
    failure: str = ""
    contrast: Optional[float] = None
    objects: Tuple[FoundObject, ...] = ()


@dataclass(frozen=True)
class Record:
    """A run as it is compared with others.

    Attributes:
        name: Name of the run.
        variant: Its variant in a sweep; empty for a session that is not part of one.
        config: Its configuration, without paths.
        summary: Its result.
        tables: Columns (N,) of each table by name, as Session.read_table returns them, with fewer rows.
        contrast: Largest over smallest predicted standard deviation; None if nothing was learned.
        objects: What clustering found.
        failure: Why the run failed; empty if it did not.
        computer: Processor and versions that the run was made with.
    """

    name: str
    variant: str
    config: Config
    summary: Summary
    tables: Dict[str, Dict[str, np.ndarray]]
    contrast: Optional[float] = None
    objects: Tuple[FoundObject, ...] = ()
    failure: str = ""
    computer: str = ""

    def read_table(self, name: str) -> Dict[str, np.ndarray]:
        """Return the columns (N,) of a table, like Session.read_table."""
        return self.tables[name]


def record_session(session: Session, variant: str = "", failure: str = "", wall_time: float = 0.0) -> Record:
    """Return the record of a session, with all rows of its tables.

    Args:
        session: A session that has ended.
        variant: Its variant in a sweep.
        failure: Why it failed.
        wall_time: Duration of all launches [s].
    """
    contrast, objects = _cluster(session) if not failure and os.path.lexists(session.paths.model) else (None, ())
    return Record(
        name=session.name,
        variant=variant,
        config=session.config,
        summary=summarise(session, finished=not failure, wall_time=wall_time),
        tables={name: session.read_table(name) for name in COLUMNS},
        contrast=contrast,
        objects=objects,
        failure=failure,
        computer=describe_computer(),
    )


def write_record(folder: Path, record: Record) -> None:
    """Write a record with thinned-out tables; record.yaml comes last, so that its existence means completeness."""
    for name, columns in record.tables.items():
        write_rows(folder / f"{name}.csv", _thin_rows(columns, _ROWS.get(name, _MAX_ROWS)), list(columns))
    content = _RecordFile(
        format=FORMAT,
        version=CONFIG_VERSION,
        package_version=__version__,
        summary=record.summary,
        config=record.config.portable(),
        computer=record.computer,
        variant=record.variant,
        failure=record.failure,
        contrast=record.contrast,
        objects=record.objects,
    )
    write_checksummed(folder / RECORD_FILE, to_plain(content))


def load_record(folder: Path) -> Record:
    """Return the record in a folder, or that of a session. Raises CorruptFileError if it is neither."""
    folder = Path(folder)
    path = folder / RECORD_FILE
    if not path.is_file():
        session = Session.open_read_only(folder)
        stored = readable_summary(session.paths.summary)
        finished, wall_time = (stored.finished, stored.wall_time) if stored else (False, 0.0)
        return Record(
            name=session.name,
            variant="",
            config=session.config,
            summary=summarise(session, finished, wall_time),
            tables={name: session.read_table(name) for name in COLUMNS},
        )
    content = read_checksummed(path, _READER, FORMAT, CONFIG_VERSION)
    found = build(_RecordFile, content, path, CorruptFileError, _READER.remedy)
    try:
        config = Config.from_dict(found.config, stored=True)
    except ConfigError as error:
        raise CorruptFileError(f"{path}: {error}; {_READER.remedy}") from error
    return Record(
        name=folder.name,
        variant=found.variant,
        config=config,
        summary=found.summary,
        tables={name: read_table(folder / f"{name}.csv", columns) for name, columns in COLUMNS.items()},
        contrast=found.contrast,
        objects=found.objects,
        failure=found.failure,
        computer=found.computer,
    )


def has_record(folder: Path) -> bool:
    """Return whether a folder has a complete record."""
    return (folder / RECORD_FILE).is_file()


def describe_computer() -> str:
    """Return the processor and the versions that results may depend on."""
    processor = processor_name() or platform.processor() or platform.machine()
    python, cores = platform.python_version(), os.cpu_count()
    versions = f"Python {python}, torch {torch.__version__}, numpy {np.__version__}"
    return f"{processor}, {cores} cores; {versions}; {load_kernels().description}"


def _cluster(session: Session) -> Tuple[float, Tuple[FoundObject, ...]]:
    """Return contrast and objects of a session's model, compared with the true objects."""
    clustering = FingerprintRun(session.paths.path).clustering
    truth = true_scene(session.config).objects
    objects = []
    for cluster in clustering.clusters:
        item, distance = nearest(cluster.centre, truth)
        x, y = (round(float(value), 4) for value in cluster.centre[:2])
        name, known = (item.name, round(distance, 4)) if item else ("", None)
        objects.append(FoundObject(cluster.kind, x, y, name, known))
    return round(clustering.contrast, 3), tuple(objects)


def _thin_rows(columns: Dict[str, np.ndarray], rows: int) -> Iterator[Dict[str, float]]:
    """Return evenly spread rows of a table, the first and last one included."""
    count = len(next(iter(columns.values())))
    for index in spread_indices(count, rows):
        yield {name: float(values[index]) for name, values in columns.items()}
