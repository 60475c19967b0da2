"""Fingerprinting one session, without robot or ROS: find the learned objects, plan or choose views, store them."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import List, Optional, Sequence, Union

from embodied_active_learning.config import FingerprintConfig
from embodied_active_learning.errors import ObservationError, SessionError
from embodied_active_learning.objects.clustering import find_objects
from embodied_active_learning.objects.collection import ViewCollection
from embodied_active_learning.objects.fingerprint import BLANK, OBJECT, Fingerprint, FingerprintSet
from embodied_active_learning.objects.stored_views import StoredViews
from embodied_active_learning.session.fingerprints import save_fingerprints
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.session_model import load_session_model


class FingerprintRun:
    """Finds the learned objects when it is made. Then fill `collections`, each begun at its start, and finish().

    Where views are taken from what is stored, collections are filled already, as far as that goes.
    """

    def __init__(
        self, session_path: Path, settings: Optional[FingerprintConfig] = None, from_stored: bool = False
    ) -> None:
        """Read the newest model of a session, also while it learns, and cluster its conditional entropy.

        settings: how, if not as the session's own configuration has it. from_stored: views are stored observations,
        not new ones.
        Raises SessionError when the session does not exist or has not learned anything, CorruptFileError for damage.
        """
        self._path = Path(session_path)
        session = Session.open_read_only(self._path)
        self._config = replace(session.config, fingerprint=settings or session.config.fingerprint)
        trained = load_session_model(session)
        if trained is None:
            raise SessionError(
                f"session {session.name} has not learned anything yet: learning begins after "
                f"training/first_update_at ({self._config.training.first_update_at}) observations; call again later"
            )
        self._trained = trained
        with session.open_observations() as store:
            seen = store.snapshot()
        self._observations = len(seen.stamps)
        seed = self._config.exploration.seed
        self.clustering = find_objects(trained.model, seen.raw_states, seen.images, self._config, seed)
        self._from_stored = from_stored
        self.collections: Sequence[Union[ViewCollection, StoredViews]] = [
            StoredViews(self._config, cluster.centre, seed, seen.raw_states, seen.images)
            if from_stored
            else ViewCollection(self._config, cluster.centre, seed)
            for cluster in self.clustering.clusters
        ]

    @property
    def names(self) -> List[str]:
        """The names of the fingerprints to be: object-1, object-2, ... and blank-1."""
        count = {OBJECT: 0, BLANK: 0}
        names = []
        for cluster in self.clustering.clusters:
            count[cluster.kind] += 1
            names.append(f"{cluster.kind}-{count[cluster.kind]}")
        return names

    @property
    def nothing_found(self) -> str:
        """Why there is nothing to take fingerprints of, in words; empty when there is something."""
        if not self.clustering.flat:
            return ""
        return (
            f"nothing to find: {self._contrast()}, less than fingerprint/min_contrast "
            f"({self._config.fingerprint.min_contrast:g}); let it learn longer, or put objects on the table"
        )

    @property
    def finding(self) -> str:
        """What was found, in words."""
        if self.clustering.flat:
            return self.nothing_found
        clustering = self.clustering
        objects = sum(cluster.kind == OBJECT for cluster in clustering.clusters)
        beyond = len(clustering.unreachable)
        more = f"; {beyond} more out of the camera's reach were left out" if beyond else ""
        return f"{objects} objects and a blank region: {self._contrast()}{more}"

    def _contrast(self) -> str:
        return f"the predicted standard deviation varies by {self.clustering.contrast:.1f}x over the workspace"

    def require_complete(self, name: str) -> None:
        """Raise ObservationError unless the fingerprint of that name has all its views."""
        collection = self.collections[self.names.index(name)]
        if not collection.complete and self._from_stored:
            raise ObservationError(
                f"{name}: only {len(collection.states)} of fingerprint/views ({self._config.fingerprint.views}) "
                f"different views are stored within fingerprint/view_box ({self._config.fingerprint.view_box:g} m) of "
                "it, and nothing was stored: take them with an arm, or ask for fewer views"
            )
        if not collection.complete:
            raise ObservationError(
                f"{name}: only {len(collection.states)} of fingerprint/views ({self._config.fingerprint.views}) "
                "different views could be taken, nothing was stored: see whether the arm moves, or ask for fewer views"
            )

    def finish(self) -> FingerprintSet:
        """Encode the views of every collection and store the fingerprints, in place of earlier ones.

        Raises ObservationError when a collection is not complete; nothing is stored then. Raises SessionError when the
        disk fails.
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
        fingerprints = []
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
        return fingerprints
