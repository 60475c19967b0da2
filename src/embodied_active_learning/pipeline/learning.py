"""Learn a world in one process, without ROS: the nodes' exploration and training against the PyBullet simulation.

A run has the same content as one of learn.launch: planner and trainer are in lock-step (training/max_lag 0), and the
times of observations are rounded like ROS times.
"""

from __future__ import annotations

import logging
import threading
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Callable, Iterator, Optional, Tuple, Type

import numpy as np
import torch

from embodied_active_learning.config import SIMULATED, Config
from embodied_active_learning.distributed.local import start_workers
from embodied_active_learning.errors import ConfigError
from embodied_active_learning.model.build import set_threads
from embodied_active_learning.model.learner import UpdateReport
from embodied_active_learning.pipeline.exploration import (
    ExplorationRun,
    await_log_std,
    exploration_row,
    first_command,
)
from embodied_active_learning.pipeline.progress import Progress, ProgressPrinter
from embodied_active_learning.pipeline.training import TrainingRun
from embodied_active_learning.session.conclusion import conclude_launch
from embodied_active_learning.session.session import Session
from embodied_active_learning.simulation.simulation import Simulation
from embodied_active_learning.simulation.world import load_world

LOG = logging.getLogger(__name__)

ProgressCallback = Callable[[Progress], None]
_PROGRESS_PERIOD = 0.5
"""Seconds between progress reports while the last updates are made."""


def learn(config: Config, on_progress: Optional[ProgressCallback] = None) -> Session:
    """Explore a simulated world and train the model. Paper, Alg. 1.

    A session that was interrupted is continued if session/resume is set; its steps are then not those of an
    uninterrupted run.

    Args:
        config: Configuration of a new session, as load_config returns it.
        on_progress: Called after each step, and regularly while the last updates are made. Default: print a line to
            stderr every 30 s; `lambda progress: None` prints nothing.

    Returns:
        The finished session, open for reading.

    Raises:
        ConfigError: arm/robot is not the simulation.
        WorldError: The world cannot be built.
        SessionError: The session exists or cannot be written.
        DivergenceError: Training diverged repeatedly.
    """
    if config.arm.robot != SIMULATED:
        raise ConfigError(f"arm/robot is {config.arm.robot}: only the simulation can be explored without ROS")
    ExplorationRun(config)  # an explorer or measure that cannot be used must not leave a session without steps
    started_at = time.monotonic()
    world = load_world(config.simulation.world, config.workspace.box())
    with Simulation(world, config) as simulation:
        training = BackgroundTraining(config)
        folder = training.run.folder
        with _summary(folder, started_at), training:
            _explore(config, simulation, training, on_progress or ProgressPrinter())
    return Session.open_read_only(folder)


@contextmanager
def _summary(folder: Path, started_at: float) -> Iterator[None]:
    """Write the summary of a session at the end of the block; an unfinished one if the block is interrupted."""
    try:
        yield
    except BaseException:
        try:
            _conclude(folder, started_at, finished=False)
        except Exception as error:  # it must not hide what ended the run
            LOG.warning("summary of the unfinished run not written: %s", error)
        raise
    _conclude(folder, started_at, finished=True)


def _conclude(folder: Path, started_at: float, finished: bool) -> None:
    conclude_launch(Session.open_read_only(folder), finished, time.monotonic() - started_at)


class BackgroundTraining:
    """A TrainingRun that trains in a thread of its own. Leaving the context writes a checkpoint and ends it."""

    def __init__(self, config: Config, local_workers: bool = True) -> None:
        """Create or resume the configured session.

        Args:
            config: Of the run.
            local_workers: Start the configured trainers, besides the first, as processes of this computer.

        Raises:
            EmbodiedActiveLearningError: The session cannot be created or resumed.
        """
        self._config = config
        self._torch_threads = torch.get_num_threads()
        set_threads(config)
        try:
            self.run = TrainingRun(config)
        except BaseException:
            torch.set_num_threads(self._torch_threads)
            raise
        self.report: Optional[UpdateReport] = None
        """Report of the newest update."""
        self._error: Optional[Exception] = None
        self._thread = threading.Thread(target=self._train, name="training")
        self._local_workers = local_workers
        self._cleanup = ExitStack()

    def __enter__(self) -> BackgroundTraining:
        torch.set_num_threads(self.run.loss.torch_threads)
        with ExitStack() as started:
            started.callback(torch.set_num_threads, self._torch_threads)
            started.callback(self.run.close)
            if self.run.pool is not None and self._local_workers:
                started.enter_context(start_workers(self._config.training.trainers - 1, self.run.pool.address))
            self._thread.start()
            started.callback(self._stop)
            self._cleanup = started.pop_all()
        return self

    def __exit__(
        self,
        kind: Optional[Type[BaseException]],
        error: Optional[BaseException],
        trace: Optional[TracebackType],
    ) -> None:
        self._cleanup.close()
        if error is None:
            self.check()

    def check(self) -> None:
        """Raise the error that has ended training, if any."""
        if self._error is not None:
            raise self._error

    def log_std(self, states: np.ndarray, observations: int) -> Optional[np.ndarray]:
        """Return the log standard deviation (S,) at states (S, 3) [m, m, rad]; None before anything is learned.

        Waits for the model that is awaited after this many observations.
        """

        def query(min_updates: int) -> Tuple[Optional[np.ndarray], bool]:
            self.check()
            log_std, _, ready = self.run.log_std(states, min_updates)
            return None if log_std is None else np.asarray(log_std, dtype=np.float64), ready

        return await_log_std(lambda: self.run.config, observations, query)

    def _stop(self) -> None:
        self.run.stop()
        self._thread.join()

    def _train(self) -> None:
        try:
            self.run.train(self._on_update)
        except Exception as error:  # raised again in the exploring thread by check()
            self._error = error

    def _on_update(self, report: UpdateReport) -> None:
        self.report = report


def _explore(
    config: Config, simulation: Simulation, training: BackgroundTraining, on_progress: ProgressCallback
) -> None:
    """Make the remaining steps, then wait for the remaining updates."""
    run = training.run
    session = Session.open_read_only(run.folder)
    rows = session.read_table("exploration")
    effort = float(rows["effort"][-1]) if len(rows["effort"]) else 0.0
    exploration = ExplorationRun(config, run.trajectory, effort)
    measure, elapsed = float("nan"), _last_stamp(session)
    with session.open_table("exploration") as table:
        table.truncate_after("step", len(run.trajectory))
        simulation.execute(first_command(config, run.trajectory))
        while exploration.step < run.config.exploration.steps:
            stamp, state, velocity = ros_seconds(elapsed + simulation.time), simulation.pose, simulation.velocity
            run.observe(exploration.step, stamp, state.tolist(), simulation.image())
            exploration.observe(state, velocity)
            metrics = exploration.evaluate_step(training.log_std(exploration.sample_states, exploration.step))
            table.append(exploration_row(stamp, state, metrics))
            measure = metrics.ergodic_measure
            on_progress(_progress(training, measure))
            if exploration.step < run.config.exploration.steps:
                simulation.execute(exploration.next_command())
    while not run.finished:
        training.check()
        time.sleep(_PROGRESS_PERIOD)
        on_progress(_progress(training, measure))


def _last_stamp(session: Session) -> float:
    """Return the simulated time [s] at which the earlier launches of a session ended; 0 in a new one."""
    with session.open_observations() as store:
        stamps = store.snapshot().stamps
    return float(stamps[-1]) if len(stamps) else 0.0


def ros_seconds(seconds: float) -> float:
    """Return a time in seconds as a ROS time holds it: whole nanoseconds, rounded down."""
    whole = int(seconds)
    return whole + int((seconds - whole) * 1e9) / 1e9


def _progress(training: BackgroundTraining, ergodic_measure: float) -> Progress:
    report, config, check = training.report, training.run.config, training.run.stop_check
    return Progress(
        step=training.run.observations,
        steps=config.exploration.steps,
        updates=training.run.updates,
        updates_planned=config.update_plan.total,
        loss=float("nan") if report is None else report.loss,
        active_units=float("nan") if report is None else report.active_units,
        latent_size=config.model.latent_size,
        ergodic_measure=ergodic_measure,
        latent_contribution=training.run.latent_contribution,
        stopping="" if check is None else check.describe(),
    )
