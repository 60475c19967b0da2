"""Fingerprinting of one session without ROS: cluster, plan or select views, encode and store them."""

from __future__ import annotations

import logging
import time
from dataclasses import replace
from pathlib import Path
from typing import List, Mapping, Optional, Sequence, Union

import numpy as np

from embodied_active_learning.config import TABLE, Config, FingerprintConfig
from embodied_active_learning.errors import ObservationError, SessionError
from embodied_active_learning.model.verdict import UNUSED, ReconstructionErrors, describe_latent_use
from embodied_active_learning.objects.appearance import Appearance
from embodied_active_learning.objects.calibration import calibrate
from embodied_active_learning.objects.clustering import Clustering, find_objects, warn_about_bandwidth
from embodied_active_learning.objects.collection import ViewCollection
from embodied_active_learning.objects.fingerprint import BLANK, OBJECT, Fingerprint, FingerprintSet
from embodied_active_learning.objects.stored_views import ObservedViews
from embodied_active_learning.session.fingerprints import save_fingerprints
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.session_model import load_session_model

LOG = logging.getLogger(__name__)


class FingerprintRun:
    """Clusters the conditional entropy of a session; then fill `collections` with views and call `finish`.

    With stored views, the collections are filled as far as possible.
    """

    def __init__(
        self, session_path: Path, settings: Optional[FingerprintConfig] = None, from_stored: bool = False
    ) -> None:
        """Load the newest model of a session, also during training, and cluster its conditional entropy.

        Args:
            session_path: Folder of the session.
            settings: Settings in place of those of the session's configuration.
            from_stored: Whether views are selected from stored observations instead of taken by an arm.

        Raises:
            SessionError: If the session does not exist or has no trained model yet.
            CorruptFileError: If a file of the session is damaged.
        """
        self._path = Path(session_path)
        session = Session.open_read_only(self._path)
        self._config = replace(session.config, fingerprint=settings or session.config.fingerprint)
        trained = load_session_model(session)
        if trained is None:
            raise SessionError(
                f"session {session.name} has no trained model yet: training begins after "
                f"{self._config.training.first_update_at} observations (training/first_update_at); retry later"
            )
        self._trained = trained
        self._weakness = describe_weakness(session.read_table("evaluation"), trained.updates)
        with session.open_observations() as store:
            stored = store.snapshot()
        self._observations = len(stored.stamps)
        seed = self._config.exploration.seed
        warn_about_bandwidth(self._config.fingerprint)
        self.clustering = find_objects(trained.model, stored.raw_states, stored.images, self._config, seed)
        self._from_stored = from_stored
        self.collections: Sequence[Union[ViewCollection, ObservedViews]] = [
            ObservedViews(self._config, cluster.centre, seed, stored.raw_states, stored.images)
            if from_stored
            else ViewCollection(self._config, cluster.centre, seed)
            for cluster in self.clustering.clusters
        ]

    @property
    def names(self) -> List[str]:
        """Names of the fingerprints: object-1, object-2, ... and blank-1."""
        count = {OBJECT: 0, BLANK: 0}
        names = []
        for cluster in self.clustering.clusters:
            count[cluster.kind] += 1
            names.append(f"{cluster.kind}-{count[cluster.kind]}")
        return names

    @property
    def is_doubtful(self) -> bool:
        """Whether the model is weak, or nothing was found that could be learned."""
        return bool(self._weakness) or not any(cluster.kind == OBJECT for cluster in self.clustering.clusters)

    @property
    def summary(self) -> str:
        """Result of the clustering in one sentence, and whether it is too early to trust it."""
        return describe_clustering(self.clustering, self._config.fingerprint) + self._weakness

    def require_complete(self, name: str) -> None:
        """Raise ObservationError if the views of a fingerprint are incomplete."""
        collection, settings = self.collections[self.names.index(name)], self._config.fingerprint
        if not collection.complete and self._from_stored:
            raise ObservationError(
                f"{name}: too few stored views: {len(collection.states)} of {settings.views} (fingerprint/views) "
                f"within {settings.view_box:g} m (fingerprint/view_box); take them with the arm, or request fewer views"
            )
        if not collection.complete:
            raise ObservationError(
                f"{name}: too few different views: {len(collection.states)} of {settings.views} (fingerprint/views); "
                "check whether the arm moves, or request fewer views"
            )

    def finish(self) -> FingerprintSet:
        """Encode the views of every collection and store the fingerprints in place of earlier ones.

        Raises:
            ObservationError: If a collection is incomplete; nothing is stored then.
            SessionError: If writing fails.
        """
        for name in self.names:
            self.require_complete(name)
        found = FingerprintSet(
            session=self._path.name,
            updates=self._trained.updates,
            observations=self._observations,
            created=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            config=self._config,
            weights=self._trained.weights,
            fingerprints=tuple(self._fingerprints()),
        )
        save_fingerprints(self._path, found)
        return found

    def _fingerprints(self) -> Sequence[Fingerprint]:
        """Encode the views of every collection."""
        fingerprints: List[Fingerprint] = []
        for name, cluster, collection in zip(self.names, self.clustering.clusters, self.collections):
            means, stds = self._trained.model.encode(collection.states, collection.images)
            fingerprints.append(
                Fingerprint(
                    name=name,
                    kind=cluster.kind,
                    centre=cluster.centre,
                    states=collection.states,
                    images=collection.images,
                    latent_means=means,
                    latent_stds=stds,
                    importance=cluster.share if cluster.kind == OBJECT else 0.0,
                )
            )
        return [calibrated(item, fingerprints, self._config) for item in fingerprints]


def describe_clustering(clustering: Clustering, settings: FingerprintConfig) -> str:
    """Return the result of a clustering in one sentence."""
    contrast = f"the predicted standard deviation varies by {clustering.contrast:.1f}x over the workspace"
    if clustering.low_contrast:
        return (
            f"no objects found: {contrast}, less than {settings.min_contrast:g} (fingerprint/min_contrast); train "
            "longer, or put objects on the table"
        )
    objects = sum(cluster.kind == OBJECT for cluster in clustering.clusters)
    unreachable = len(clustering.unreachable)
    prints = len(clustering.visible.prints) if settings.clustering == TABLE else 0
    skipped = f"; skipped {unreachable} more that the camera cannot reach" if unreachable else ""
    if prints:
        skipped += f"; skipped {prints} in the plane of the table (to keep them: fingerprint/prints)"
    return f"{objects} objects and a blank region: {contrast}{skipped}"


def describe_unrecognisable(found: FingerprintSet) -> str:
    """Return the end of a sentence that names objects that cannot be recognised elsewhere; empty without any."""
    names = [item.name for item in found.fingerprints if item.kind == OBJECT and item.calibration is None]
    if not names:
        return ""
    return f"; {', '.join(names)} will not be recognised elsewhere: see the log of the fingerprinter"


def calibrated(fingerprint: Fingerprint, fingerprints: Sequence[Fingerprint], config: Config) -> Fingerprint:
    """Return a fingerprint with its calibration, if it is of an object that can be recognised; log why if it cannot.

    Args:
        fingerprint: One of the fingerprints.
        fingerprints: All fingerprints of a session.
        config: Of the session, with the settings of these fingerprints.
    """
    if fingerprint.kind != OBJECT:
        return fingerprint
    appearance = Appearance(fingerprint, fingerprints, config.camera)
    if appearance.problem:
        LOG.warning("%s will not be recognised elsewhere: %s", fingerprint.name, appearance.problem)
        return fingerprint
    objects = [item.name for item in fingerprints if item.kind == OBJECT]
    number = 1 + objects.index(fingerprint.name)
    LOG.info("computing the limits of %s (%d of %d)", fingerprint.name, number, len(objects))
    return replace(fingerprint, calibration=calibrate(appearance, config.fingerprint.trials))


def describe_weakness(evaluation: Mapping[str, np.ndarray], updates: int) -> str:
    """Return the end of a sentence that says why the model may be too weak; empty if it is good.

    Args:
        evaluation: The session's table of that name.
        updates: Number of updates of the model.
    """
    if not len(evaluation["mse_own"]):
        return f"; the model is not evaluated yet ({updates} updates): make the fingerprints again after more steps"
    errors = ReconstructionErrors(*(float(evaluation[f"mse_{name}"][-1]) for name in ReconstructionErrors._fields))
    if errors.latent_contribution >= UNUSED:
        return ""
    return f"; the model is weak: {describe_latent_use(errors)}; make the fingerprints again after more steps"
