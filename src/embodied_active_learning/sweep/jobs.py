"""One run of a sweep, as a job for a worker process or a cluster."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Optional

from embodied_active_learning.config import Config, merge
from embodied_active_learning.errors import CorruptFileError, DivergenceError, SessionError
from embodied_active_learning.pipeline.learning import learn
from embodied_active_learning.pipeline.progress import Progress
from embodied_active_learning.pipeline.resolve import resolve_config
from embodied_active_learning.session.disk import estimate_bytes, folder_size
from embodied_active_learning.session.paths import SessionPaths
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.summary import read_summary
from embodied_active_learning.sweep.run_records import has_record, load_record, record_session, write_record
from embodied_active_learning.sweep.spec import SweepRun, differences


@dataclass(frozen=True)
class Job:
    """A run, where its session and its record are stored, and how many threads train it.

    A job can be repeated at any time: a run with a record is not repeated, and a session is resumed.
    """

    run: SweepRun
    sessions: Path
    records: Path
    threads: int

    @property
    def session(self) -> Path:
        """Folder of the session."""
        return self.sessions / self.run.name

    @property
    def record(self) -> Path:
        """Folder of the record."""
        return self.records / self.run.name

    @property
    def complete(self) -> bool:
        """Whether the run is complete, here or elsewhere."""
        return has_record(self.record)

    @property
    def started(self) -> bool:
        """Whether there is a session; a process that is killed while creating one leaves a folder without."""
        return SessionPaths(self.session).config.is_file()

    def check(self) -> None:
        """Raise SessionError if the stored run was made with other settings, or cannot be read."""
        stored = self._stored()
        changes = differences(stored, self.run.config) if stored else []
        if changes:
            place = self.record if self.complete else self.session
            raise SessionError(
                f"run {self.run.name} is stored in {place} with other settings: {'; '.join(changes)}; restore the "
                "settings, rename the sweep, or delete the stored run"
            )

    def progress(self) -> Progress:
        """Return how far the run is, also while another process makes it."""
        config = self.run.config
        steps = updates = 0
        if self.complete:
            steps, updates = config.exploration.steps, config.update_plan.total
        elif self.started:
            session = Session.open_read_only(self.session)
            steps = len(session.read_table("exploration")["step"])
            made = session.read_table("training")["update"]
            updates = int(made[-1]) if len(made) else 0
        return Progress(steps, config.exploration.steps, updates, config.update_plan.total)

    def bytes_needed(self) -> int:
        """Return the bytes that the rest of the run stores."""
        stored = folder_size(self.session) if self.started else 0
        return 0 if self.complete else max(0, estimate_bytes(self.run.config) - stored)

    def __call__(self) -> str:
        """Make or continue the run and store its record. Return what happened, in one line.

        A run that diverges is recorded as failed, because it would diverge again.

        Raises:
            EmbodiedActiveLearningError: Like learn.
        """
        if self.complete:
            return f"{self.run.name}: already completed"
        config, failure = self._config(), ""
        try:
            session = learn(config, lambda progress: None)  # the sweep reports all runs in one line
        except DivergenceError as error:
            session, failure = Session.open_read_only(self.session), str(error)
        wall_time = read_summary(session.paths.summary).wall_time
        record = record_session(session, self.run.variant, failure, wall_time)
        write_record(self.record, record)
        return f"{self.run.name}: {failure or record.summary.verdict}"

    def checkpoint(self) -> object:
        """Return the submission that continues this job when submitit has to interrupt it."""
        from submitit.helpers import DelayedSubmission  # noqa: PLC0415 - optional

        return DelayedSubmission(self)

    def _config(self) -> Config:
        changes = merge(dict(self.run.changes), {"training": {"threads": self.threads}})
        place = {"root": str(self.sessions), "name": self.run.name, "resume": self.started}
        return resolve_config(self.run.profile, merge(changes, {"session": place}))

    def _stored(self) -> Optional[Config]:
        """Return the configuration of the stored run, if there is one."""
        if self.complete:
            return load_record(self.record).config
        try:
            return Session.open_read_only(self.session).config if self.started else None
        except CorruptFileError as error:
            raise SessionError(f"{error}; or delete {self.session} to repeat the run") from error
