"""The observations of a run: an append-only file of checksummed records, mirrored in memory for the learner.

An observation is acknowledged once it is on the disk. A killed process leaves at most one incomplete record at the end
of the file, which was not acknowledged and is removed when the store is opened for writing.
"""

from __future__ import annotations

import os
import threading
from pathlib import Path
from typing import NamedTuple, Optional, Sequence, Tuple

import numpy as np

from embodied_active_learning.errors import CorruptFileError, ObservationError, SessionError
from embodied_active_learning.session.atomic import make_folder
from embodied_active_learning.session.observation_records import RecordFile, RecordLayout
from embodied_active_learning.workspace import Workspace

LAYOUT_FILE = "format.json"
DATA_FILE = "observations.bin"
_FIRST_CAPACITY = 64


class Observations(NamedTuple):
    """N observations as arrays of equal length."""

    states: np.ndarray  # (N, D) float32, normalised
    raw_states: np.ndarray  # (N, D) float64, SI units
    images: np.ndarray  # (N, H, W, 3) uint8 RGB
    stamps: np.ndarray  # (N,) float64, seconds


class ObservationStore:
    """Observations on disk and in memory: one writing process, any number of reading threads and processes."""

    def __init__(
        self, folder: Path, layout: RecordLayout, workspace: Workspace, writable: bool, capacity: int = 0
    ) -> None:
        if len(layout.state_names) != workspace.size:
            raise CorruptFileError(
                f"{folder / LAYOUT_FILE}: state_names are {list(layout.state_names)}, but the workspace has "
                f"{workspace.size} dimensions: choose another session"
            )
        self.layout = layout
        self._workspace = workspace
        self._writable = writable
        self._appending = threading.Lock()
        self._count = 0
        self._arrays = _allocate(layout, max(capacity, _FIRST_CAPACITY))
        self._file = RecordFile(folder / DATA_FILE, layout, writable)
        try:
            self._load()
        except BaseException:
            self._file.close()
            raise

    @classmethod
    def open_for_writing(
        cls, folder: Path, workspace: Workspace, image_shape: Sequence[int], capacity: int = 0
    ) -> ObservationStore:
        """Create a store, or continue an existing one.

        Args:
            folder: Folder of the store.
            workspace: Converts states to normalised units.
            image_shape: (H, W, 3).
            capacity: Expected number of observations.

        Raises:
            CorruptFileError: The store is damaged.
            SessionError: Another process writes it.
            ObservationError: It has images of another shape.
        """
        layout = _own_layout(Path(folder), tuple(image_shape))
        return cls(Path(folder), layout, workspace, writable=True, capacity=capacity)

    @classmethod
    def open_read_only(
        cls, folder: Path, workspace: Workspace, image_shape: Optional[Sequence[int]] = None
    ) -> ObservationStore:
        """Open a store for reading, also while another process writes it.

        Raises:
            CorruptFileError: The store is damaged.
            SessionError: There is no store.
            ObservationError: Its images do not have image_shape.
        """
        folder = Path(folder)
        if not os.path.lexists(folder / DATA_FILE):
            raise SessionError(f"{folder} has no observations yet: start the exploration")
        layout = RecordLayout.load(folder / LAYOUT_FILE)
        if image_shape is not None:
            _check_shape(folder / LAYOUT_FILE, layout, tuple(image_shape))
        return cls(folder, layout, workspace, writable=False)

    def append(self, index: int, stamp: float, state: Sequence[float], image: np.ndarray) -> bool:
        """Store an observation on the disk.

        Args:
            index: Its number, from 0; the next one, or a repetition of a stored one.
            stamp: Time in seconds.
            state: (D,) SI units.
            image: (H, W, 3) uint8 RGB.

        Returns:
            True if it is new, False if the same observation was stored before.

        Raises:
            ObservationError: Invalid values, or another number than the next one.
            SessionError: The disk failed.
        """
        if not self._writable:
            raise SessionError(f"{self._file.path} is open read-only: open the session for writing")
        values: np.ndarray = np.asarray(state, dtype=np.float64)
        self._check(stamp, values, image)
        with self._appending:
            if index != self._count:
                self._check_repeated(index, stamp, values, image)
                return False
            self._file.write(index, self.layout.pack(index, stamp, values, image))
            self._add(stamp, values, image)
        return True

    def refresh(self) -> int:
        """Read new observations of another process into a read-only store. Return the number of observations.

        Raises:
            CorruptFileError: A record is damaged.
        """
        with self._appending:
            for record in self._file.read(self._count):
                self._add(float(record["stamp"]), record["state"], record["image"])
            return self._count

    def snapshot(self) -> Observations:
        """Return all arrays at equal length. Later observations do not change them."""
        count = self._count  # read first, because the arrays are at least that long
        return Observations(*(array[:count] for array in self._arrays))

    @property
    def states(self) -> np.ndarray:
        """Normalised states. (N, D) float32."""
        return self.snapshot().states

    @property
    def raw_states(self) -> np.ndarray:
        """States in SI units. (N, D) float64."""
        return self.snapshot().raw_states

    @property
    def images(self) -> np.ndarray:
        """Images. (N, H, W, 3) uint8 RGB."""
        return self.snapshot().images

    @property
    def stamps(self) -> np.ndarray:
        """Times in seconds. (N,) float64."""
        return self.snapshot().stamps

    def __len__(self) -> int:
        return self._count

    def close(self) -> None:
        """Close the file and release its lock; the arrays stay valid."""
        with self._appending:
            self._writable = False
            self._file.close()

    def __enter__(self) -> ObservationStore:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _load(self) -> None:
        for record in self._file.read():
            self._add(float(record["stamp"]), record["state"], record["image"])
        if self._writable:
            self._file.cut_after(self._count)

    def _add(self, stamp: float, state: np.ndarray, image: np.ndarray) -> None:
        if self._count == len(self._arrays.stamps):
            larger = _allocate(self.layout, 2 * self._count)
            for new, old in zip(larger, self._arrays):
                new[: self._count] = old
            self._arrays = larger
        self._arrays.states[self._count] = self._workspace.normalise(state)
        self._arrays.raw_states[self._count] = state
        self._arrays.images[self._count] = image
        self._arrays.stamps[self._count] = stamp
        self._count += 1  # last, because other threads read up to the count

    def _check(self, stamp: float, state: np.ndarray, image: np.ndarray) -> None:
        shape = self.layout.image_shape
        if not isinstance(image, np.ndarray) or image.shape != shape or image.dtype != np.uint8:
            found = f"{image.dtype} {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
            raise ObservationError(f"image is {found}, expected uint8 {shape}: check camera/height and camera/width")
        names = self.layout.state_names
        if state.shape != (len(names),):
            raise ObservationError(f"state has shape {state.shape}, expected ({len(names)},): {', '.join(names)}")
        if not (np.all(np.isfinite(state)) and np.isfinite(stamp)):
            raise ObservationError(f"state {state.tolist()} at {stamp} s is not finite: check tf and the arm")

    def _check_repeated(self, index: int, stamp: float, state: np.ndarray, image: np.ndarray) -> None:
        if not 0 <= index < self._count:
            raise ObservationError(f"observation {index} received, expected {self._count}: send that one")
        same = stamp == self._arrays.stamps[index] and np.array_equal(state, self._arrays.raw_states[index])
        if not (same and np.array_equal(image, self._arrays.images[index])):
            raise ObservationError(
                f"observation {index} is stored with other content: continue with number {self._count}"
            )


def count_observations(folder: Path) -> int:
    """Return the number of whole records in the file of a store, without reading them; 0 if there is no store.

    Raises:
        CorruptFileError: The layout is damaged.
    """
    data = Path(folder) / DATA_FILE
    return os.path.getsize(data) // RecordLayout.load(Path(folder) / LAYOUT_FILE).size if data.exists() else 0


def _allocate(layout: RecordLayout, capacity: int) -> Observations:
    """Allocate arrays; the kernel provides the memory as they are filled."""
    dimensions = len(layout.state_names)
    return Observations(
        states=np.empty((capacity, dimensions), np.float32),
        raw_states=np.empty((capacity, dimensions), np.float64),
        images=np.empty((capacity, *layout.image_shape), np.uint8),
        stamps=np.empty(capacity, np.float64),
    )


def _own_layout(folder: Path, image_shape: Tuple[int, ...]) -> RecordLayout:
    """Return the layout of a store for writing; create the files of a new one."""
    path, data = folder / LAYOUT_FILE, folder / DATA_FILE
    if not os.path.lexists(path) and not os.path.lexists(data):
        make_folder(folder)
        RecordLayout(image_shape).save(path)
    layout = RecordLayout.load(path)
    _check_shape(path, layout, image_shape)
    return layout


def _check_shape(path: Path, layout: RecordLayout, image_shape: Tuple[int, ...]) -> None:
    if layout.image_shape != image_shape:
        raise ObservationError(
            f"{path}: image_shape is {list(layout.image_shape)}, but the camera is configured for {list(image_shape)}: "
            "restore camera/height and camera/width, or choose another session"
        )
