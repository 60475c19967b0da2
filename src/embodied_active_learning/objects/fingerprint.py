"""What the model knows of each learned object: the views around it, and what the encoder makes of them."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta
from numbers import Real
from typing import TYPE_CHECKING, Any, Dict, Tuple

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.naming import check_name, check_recorded_name

if TYPE_CHECKING:
    import torch  # takes a second, which those who need no weights can do without

OBJECT, BLANK = "object", "blank"
KINDS = (OBJECT, BLANK)

# Fields of a Fingerprint that are arrays: type and shape, where a letter stands for any size from 1, the same in all.
ARRAYS: Dict[str, Tuple[type, Tuple[Any, ...]]] = {
    "centre": (np.float64, (3,)),
    "states": (np.float64, ("V", 3)),
    "images": (np.uint8, ("V", "H", "W", 3)),
    "latent_means": (np.float32, ("V", "L")),
    "latent_stds": (np.float32, ("V", "L")),
}


@dataclass(frozen=True, eq=False)
class Fingerprint:
    """What one learned object looks like from around it: a table of images, states and latents (paper, appendix).

    Raises ObservationError for anything that is not as said below, SessionError for a name that is not allowed.
    """

    name: str  # unique within its set, such as object-1
    kind: str  # OBJECT or BLANK
    centre: np.ndarray  # (3,) float64, m, m, rad: the cluster's centre
    states: np.ndarray  # (V, 3) float64, m, m, rad: the camera's poses of V >= 1 views
    images: np.ndarray  # (V, H, W, 3) uint8, red first
    latent_means: np.ndarray  # (V, L) float32
    latent_stds: np.ndarray  # (V, L) float32
    importance: float  # share of the importance samples in its cluster, 0 .. 1 (0 for a blank)

    def __post_init__(self) -> None:
        """Check every field."""
        check_name(self.name, "name of a fingerprint")
        if self.kind not in KINDS:
            raise ObservationError(f"{self.name}: kind is {self.kind!r}: legal are {', '.join(KINDS)}")
        if not isinstance(self.importance, Real) or not 0.0 <= self.importance <= 1.0:
            raise ObservationError(f"{self.name}: importance is {self.importance!r}: legal is 0 to 1")
        sizes: Dict[str, int] = {}
        for field, (dtype, shape) in ARRAYS.items():
            _check_array(f"{self.name}: {field}", getattr(self, field), np.dtype(dtype), shape, sizes)

    @property
    def thumbnail(self) -> np.ndarray:
        """(H, W, 3) uint8: the view whose x and y are closest to the centre's."""
        x, y = (self.states - self.centre).T[:2]
        return self.images[np.argmin(np.hypot(x, y))]


@dataclass(frozen=True, eq=False)
class FingerprintSet:
    """Everything that one call of /fingerprint has found, and the model that it was found with.

    Raises ObservationError for anything that is not as said below, SessionError for a session's name that is not
    allowed.
    """

    session: str  # name of the session folder
    updates: int  # updates of the model
    observations: int  # observations it had learned from
    created: str  # UTC time, ISO 8601 with its offset
    config: Config
    weights: Dict[str, torch.Tensor]  # the network's, by its own names (model/checkpoint.py, network_weights)
    fingerprints: Tuple[Fingerprint, ...]  # names are unique, images and latents as the config has them

    def __post_init__(self) -> None:
        """Check every field, and that the fingerprints fit the configuration."""
        check_recorded_name(self.session, "session of the fingerprints")
        for field in ("updates", "observations"):
            count = getattr(self, field)
            if type(count) is not int or count < 0:
                raise ObservationError(f"{field} is {count!r}: give a whole number from 0")
        if not _is_utc(self.created):
            raise ObservationError(f"created is {self.created!r}: give a UTC time such as 2026-11-22T12:45:00Z")
        names = [fingerprint.name for fingerprint in self.fingerprints]
        if len(set(names)) < len(names):
            raise ObservationError(f"names of fingerprints are {', '.join(names)}: give each its own")
        for fingerprint in self.fingerprints:
            _check_fits(fingerprint, self.config)


def _check_array(subject: str, array: Any, dtype: np.dtype, shape: Tuple[Any, ...], sizes: Dict[str, int]) -> None:
    """Check an array; sizes holds what the letters of shapes stand for, and learns those that are new."""
    expected = f"{dtype} ({', '.join(str(sizes.get(size, size)) for size in shape)}) with sizes from 1"
    if not isinstance(array, np.ndarray):
        raise ObservationError(f"{subject} is {type(array).__name__}, expected {expected}")
    fits = array.dtype == dtype and array.ndim == len(shape) and array.size > 0
    if not fits or any(
        length != (sizes.setdefault(size, length) if isinstance(size, str) else size)
        for size, length in zip(shape, array.shape)
    ):
        raise ObservationError(f"{subject} is {array.dtype} {array.shape}, expected {expected}")
    if not np.isfinite(array).all():
        raise ObservationError(f"{subject} holds values that are not finite: train longer, or check tf and the arm")


def _check_fits(fingerprint: Fingerprint, config: Config) -> None:
    height, width = fingerprint.images.shape[1:3]
    if (height, width) != (config.camera.height, config.camera.width):
        raise ObservationError(
            f"{fingerprint.name}: images are {width} x {height} px, but camera/width and camera/height are "
            f"{config.camera.width} and {config.camera.height}: use the configuration of their session"
        )
    latents = fingerprint.latent_means.shape[1]
    if latents != config.model.latent_size:
        raise ObservationError(
            f"{fingerprint.name}: latent_means has {latents} latent variables, but model/latent_size is "
            f"{config.model.latent_size}: use the configuration of their session"
        )


def _is_utc(text: Any) -> bool:
    """Whether a text is a time in UTC."""
    if not isinstance(text, str):
        return False
    try:
        # Python 3.8 does not know the Z that ISO 8601 writes for UTC.
        moment = datetime.fromisoformat(f"{text[:-1]}+00:00" if text.endswith("Z") else text)
    except ValueError:
        return False
    return moment.utcoffset() == timedelta(0)
