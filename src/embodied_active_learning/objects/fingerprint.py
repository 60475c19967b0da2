"""Fingerprints: the views of a learned object with their states and latents.

Paper, appendix "Object Fingerprinting": a fingerprint is a table of images, states and latent space samples.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime, timedelta
from numbers import Real
from typing import TYPE_CHECKING, Any, Dict, Optional, Tuple

import numpy as np

from embodied_active_learning.config import TABLE, Config
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.naming import check_name
from embodied_active_learning.objects.limits import Calibration

if TYPE_CHECKING:
    import torch  # importing it takes a second, and only the type is needed here

OBJECT, BLANK = "object", "blank"
KINDS = (OBJECT, BLANK)

# Type and shape of the array fields of a Fingerprint; a letter stands for a size of at least 1, equal in all fields.
ARRAYS: Dict[str, Tuple[type, Tuple[Any, ...]]] = {
    "centre": (np.float64, (3,)),
    "states": (np.float64, ("V", 3)),
    "images": (np.uint8, ("V", "H", "W", 3)),
    "latent_means": (np.float32, ("V", "L")),
    "latent_stds": (np.float32, ("V", "L")),
}


@dataclass(frozen=True, eq=False)
class Fingerprint:
    """Views of one learned object, from around it.

    Attributes:
        name: Unique within its set, such as `object-1`.
        kind: OBJECT or BLANK.
        centre: (3,) float64 centre of the cluster, x [m], y [m], theta [rad] in the base frame.
        states: (V, 3) float64 camera states [m, m, rad] of V >= 1 views.
        images: (V, H, W, 3) uint8, RGB.
        latent_means: (V, L) float32 mean of q(z | state, image) of each view.
        latent_stds: (V, L) float32 standard deviation of the same.
        importance: Share of the importance samples in its cluster, 0 to 1 (0 for a blank).
        calibration: From which the limits of the decision follow; None of a blank, of an object that cannot be
            recognised, and of fingerprints stored without one.

    Raises:
        ObservationError: If a field is invalid.
        SessionError: If the name is not allowed.
    """

    name: str
    kind: str
    centre: np.ndarray
    states: np.ndarray = field(repr=False)
    images: np.ndarray = field(repr=False)
    latent_means: np.ndarray = field(repr=False)
    latent_stds: np.ndarray = field(repr=False)
    importance: float
    calibration: Optional[Calibration] = field(default=None, repr=False)

    def __post_init__(self) -> None:
        """Check every field."""
        check_name(self.name, "name of a fingerprint")
        if self.kind not in KINDS:
            raise ObservationError(f"{self.name}: invalid kind {self.kind!r}: expected {' or '.join(KINDS)}")
        if not isinstance(self.importance, Real) or not 0.0 <= self.importance <= 1.0:
            raise ObservationError(f"{self.name}: importance {self.importance!r} is out of range: expected 0 to 1")
        sizes: Dict[str, int] = {}
        for name, (dtype, shape) in ARRAYS.items():
            _check_array(f"{self.name}: {name}", getattr(self, name), np.dtype(dtype), shape, sizes)

    @property
    def thumbnail(self) -> np.ndarray:
        """(H, W, 3) uint8 image of the view that is nearest to the centre in x and y."""
        x, y = (self.states - self.centre).T[:2]
        return self.images[np.argmin(np.hypot(x, y))]


@dataclass(frozen=True, eq=False)
class FingerprintSet:
    """All fingerprints of a session, and the model that encoded them.

    Attributes:
        session: Name of the session.
        updates: Number of updates of the model.
        observations: Number of observations that were stored when it was made; a model that is still learning has
            learned from fewer.
        created: UTC time, ISO 8601 with its offset.
        config: The session's configuration.
        weights: Parameters of the network by name (model/learner_state.py, `network_weights`).
        fingerprints: With unique names; images and latents have the sizes of the configuration.

    Raises:
        ObservationError: If a field is invalid.
        SessionError: If the session's name is not allowed.
    """

    session: str
    updates: int
    observations: int
    created: str
    config: Config = field(repr=False)
    weights: Dict[str, torch.Tensor] = field(repr=False)
    fingerprints: Tuple[Fingerprint, ...]

    def __post_init__(self) -> None:
        """Check every field, and that the fingerprints match the configuration."""
        check_name(self.session, "session of the fingerprints")
        for name in ("updates", "observations"):
            count = getattr(self, name)
            if type(count) is not int or count < 0:
                raise ObservationError(f"invalid {name} {count!r}: expected an integer of at least 0")
        if not _is_utc(self.created):
            raise ObservationError(f"invalid created {self.created!r}: expected UTC such as 2026-11-22T12:45:00Z")
        names = [fingerprint.name for fingerprint in self.fingerprints]
        if len(set(names)) < len(names):
            raise ObservationError(f"duplicate fingerprint name in {', '.join(names)}: names must be unique")
        for fingerprint in self.fingerprints:
            _check_fits(fingerprint, self.config)

    @property
    def without_prints(self) -> bool:
        """Whether all objects stand on the table, because prints were left out when the fingerprints were made."""
        settings = self.config.fingerprint
        return settings.clustering == TABLE and not settings.prints


def _check_array(subject: str, array: Any, dtype: np.dtype, shape: Tuple[Any, ...], sizes: Dict[str, int]) -> None:
    """Check one array; `sizes` maps the letters of shapes to sizes and is extended by new letters."""
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
        raise ObservationError(f"{subject} contains NaN or infinity: train longer, or check tf and the arm")


def _check_fits(fingerprint: Fingerprint, config: Config) -> None:
    """Check the sizes of images and latents against the configuration."""
    height, width = len(fingerprint.images[0]), len(fingerprint.images[0][0])
    if (height, width) != (config.camera.height, config.camera.width):
        raise ObservationError(
            f"{fingerprint.name}: images are {width} x {height} px but camera/width and camera/height are "
            f"{config.camera.width} and {config.camera.height}: use the configuration of its session"
        )
    latents = fingerprint.latent_means.shape[1]
    if latents != config.model.latent_size:
        raise ObservationError(
            f"{fingerprint.name}: made with {latents} latents but model/latent_size is "
            f"{config.model.latent_size}: use the configuration of its session"
        )


def _is_utc(text: Any) -> bool:
    """Whether a value is an ISO 8601 time in UTC."""
    if not isinstance(text, str):
        return False
    try:
        # Python 3.8 cannot parse the Z that ISO 8601 allows for UTC.
        moment = datetime.fromisoformat(f"{text[:-1]}+00:00" if text.endswith("Z") else text)
    except ValueError:
        return False
    return moment.utcoffset() == timedelta(0)
