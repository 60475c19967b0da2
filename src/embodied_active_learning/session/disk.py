"""Whether the disk has room for a run, asked before the run rather than found out at its end."""

from __future__ import annotations

import os
import shutil
import stat
from contextlib import suppress
from pathlib import Path

from embodied_active_learning.config import Config
from embodied_active_learning.errors import SessionError
from embodied_active_learning.session.paths import BAGS_FOLDER
from embodied_active_learning.session.records import RecordLayout

SPARE_BYTES = 200_000_000
_BYTES_PER_WEIGHT = 4
_COPIES_WITH_OPTIMISER = 4  # weights, Adam's two moments, and the weights of the model before


def check_space(folder: Path, config: Config, stored_bytes: int = 0) -> None:
    """Raise SessionError unless the folder can be written and has room for the run, less what is stored already."""
    needed = max(estimate_bytes(config) - stored_bytes, 0) + SPARE_BYTES
    existing = _existing(folder)
    if not existing.is_dir():
        raise SessionError(f"{folder} cannot be created, as {existing} is no folder: choose another session/root")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise SessionError(
            f"{folder} cannot be written, as {existing} {_why_not_writable(existing)}: mend that, or choose another "
            "session/root"
        )
    free = free_bytes(existing)
    if free < needed:
        raise SessionError(
            f"{folder} needs about {needed / 1e9:.1f} GB for {config.exploration.steps} observations of "
            f"{config.camera.width} x {config.camera.height} px, but {free / 1e9:.1f} GB are free: free some, set "
            "session/root to another disk, or lower exploration/steps"
        )


def free_bytes(path: Path) -> int:
    """Bytes that can still be written where a path is, or will be. Raises SessionError when that cannot be told."""
    try:
        return shutil.disk_usage(_existing(Path(path))).free
    except OSError as error:
        raise SessionError(f"the free space of {path} cannot be told ({error.strerror}): see to the disk") from error


def bytes_below(folder: Path) -> int:
    """Bytes in the files of a session, as far as they are still there when looked at; links and bags count nothing."""
    total = 0
    for parent, folders, names in os.walk(folder):
        if parent == str(folder) and BAGS_FOLDER in folders:
            folders.remove(BAGS_FOLDER)
        for name in names:
            with suppress(FileNotFoundError):
                status = os.lstat(os.path.join(parent, name))
                total += status.st_size if stat.S_ISREG(status.st_mode) else 0
    return total


def _existing(path: Path) -> Path:
    """The path, or the nearest one above it that there is."""
    return next(parent for parent in (path, *path.parents) if parent.exists())


def _why_not_writable(folder: Path) -> str:
    if os.statvfs(folder).f_flag & os.ST_RDONLY:
        return "lies on a disk that is mounted read-only"
    return "may not be written by this user"


def estimate_bytes(config: Config) -> int:
    """About how many bytes a whole run stores: its observations, its checkpoints and its model."""
    record = RecordLayout((config.camera.height, config.camera.width, 3)).size
    model = _BYTES_PER_WEIGHT * _estimate_weights(config)
    # One more than are kept, because a new checkpoint is whole before an old one goes.
    checkpoints = (config.training.checkpoints_kept + 1) * _COPIES_WITH_OPTIMISER * model
    return config.exploration.steps * record + checkpoints + model


def _estimate_weights(config: Config) -> int:
    """Weights of the fully connected layers, encoder and decoder; the convolutions have next to none."""
    height, width = config.camera.height, config.camera.width
    for stride in config.model.strides:
        height, width = -(-height // stride), -(-width // stride)
    features = config.model.channels[-1] * height * width
    sizes = (features, *config.model.hidden_sizes, 2 * config.model.latent_size)
    return 2 * sum(inputs * outputs for inputs, outputs in zip(sizes, sizes[1:]))
