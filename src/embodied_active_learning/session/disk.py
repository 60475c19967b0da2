"""Disk space for a run, checked before it starts."""

from __future__ import annotations

import os
import shutil
import stat
from contextlib import suppress
from pathlib import Path

from embodied_active_learning.config import Config
from embodied_active_learning.errors import SessionError
from embodied_active_learning.session.observation_records import RecordLayout
from embodied_active_learning.session.paths import BAGS_FOLDER

SPARE_BYTES = 200_000_000
_BYTES_PER_WEIGHT = 4
_COPIES_IN_CHECKPOINT = 4  # weights, Adam's two moments, and the weights of the previous model


def check_space(folder: Path, config: Config, stored_bytes: int = 0) -> None:
    """Check that a folder is writable and has space for the rest of a run.

    Args:
        folder: The session folder, which need not exist.
        config: Configuration of the run.
        stored_bytes: Bytes of the run that are stored already.

    Raises:
        SessionError: Too little space, or no permission.
    """
    needed = max(estimate_bytes(config) - stored_bytes, 0) + SPARE_BYTES
    existing = _existing(folder)
    if not existing.is_dir():
        raise SessionError(f"{folder} cannot be created, {existing} is not a folder: choose another session/root")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise SessionError(
            f"{folder} cannot be written, {existing} {_why_not_writable(existing)}: fix that, or choose another "
            "session/root"
        )
    free = free_bytes(existing)
    if free < needed:
        raise SessionError(
            f"{folder} needs about {needed / 1e9:.1f} GB for {config.exploration.steps} observations of "
            f"{config.camera.width} x {config.camera.height} px, but {free / 1e9:.1f} GB are free: free disk space, "
            "set session/root to another disk, or lower exploration/steps"
        )


def free_bytes(path: Path) -> int:
    """Return the free bytes on the disk of a path, which need not exist. Raises SessionError if that is unknown."""
    try:
        return shutil.disk_usage(_existing(Path(path))).free
    except OSError as error:
        raise SessionError(f"free space of {path} is unknown ({error.strerror}): check the disk") from error


def folder_size(folder: Path) -> int:
    """Return the bytes in the files of a session, without links and bags. Files may disappear meanwhile."""
    total = 0
    for parent, folders, names in os.walk(folder):
        if parent == str(folder) and BAGS_FOLDER in folders:
            folders.remove(BAGS_FOLDER)
        for name in names:
            with suppress(FileNotFoundError):
                status = os.lstat(os.path.join(parent, name))
                total += status.st_size if stat.S_ISREG(status.st_mode) else 0
    return total


def estimate_bytes(config: Config) -> int:
    """Estimate the bytes that a complete run stores: observations, checkpoints and model."""
    record = RecordLayout((config.camera.height, config.camera.width, 3)).size
    model = _BYTES_PER_WEIGHT * _estimate_weights(config)
    # One more than are kept, because a new checkpoint is complete before an old one is deleted.
    checkpoints = (config.training.checkpoints_kept + 1) * _COPIES_IN_CHECKPOINT * model
    return config.exploration.steps * record + checkpoints + model


def _existing(path: Path) -> Path:
    """Return the path or its nearest existing parent."""
    return next(parent for parent in (path, *path.parents) if parent.exists())


def _why_not_writable(folder: Path) -> str:
    if os.statvfs(folder).f_flag & os.ST_RDONLY:
        return "is on a disk that is mounted read-only"
    return "is not writable by this user"


def _estimate_weights(config: Config) -> int:
    """Estimate the weights of the fully connected layers; the convolutions have few."""
    height, width = config.camera.height, config.camera.width
    for stride in config.model.strides:
        height, width = -(-height // stride), -(-width // stride)
    features = config.model.channels[-1] * height * width
    sizes = (features, *config.model.hidden_sizes, 2 * config.model.latent_size)
    return 2 * sum(inputs * outputs for inputs, outputs in zip(sizes, sizes[1:]))
