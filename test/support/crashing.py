"""Kill the nodes of a learning run at random until the run has ended nevertheless."""

import os
import random
import signal
import subprocess
import time
from contextlib import suppress
from pathlib import Path
from typing import Callable, Dict, Iterator, List, NamedTuple

from embodied_active_learning.session.checkpoints import load_model
from embodied_active_learning.session.observations import DATA_FILE
from embodied_active_learning.session.paths import SessionPaths
from embodied_active_learning.session.session import Session
from launching import ROOT, environment, is_finished, processes_of, started

EVERYTHING = "everything"
INTERRUPTION = "interrupt"
FREEZE = "frozen planner"
TABLES = ("exploration.csv", "training.csv", "evaluation.csv")
PROFILE = ROOT / "test" / "system" / "crashes.yaml"
NODES = ("ergodic_planner", "fingerprinter", "monitor", "pybullet_arm", "trainer")
STEPS_BETWEEN = (0, 1, 2, 4)  # steps between two kills: some come while nodes are still starting
MAX_WAIT = 0.4  # s after these steps
FREEZE_TIME = 3.0  # s, longer than arm/commander_timeout of the profile


class Crash(NamedTuple):
    """A killed node, and the number of observations stored by then."""

    victim: str
    stored: int


def kill(number: int) -> None:
    """Send SIGKILL to a process, if it still exists."""
    with suppress(ProcessLookupError):
        os.kill(number, signal.SIGKILL)


def freeze(number: int) -> None:
    """Freeze a process so long that the arm stops without its commander."""
    with suppress(ProcessLookupError):
        os.kill(number, signal.SIGSTOP)
        time.sleep(FREEZE_TIME)
        os.kill(number, signal.SIGCONT)


def kill_everything(launch: subprocess.Popen) -> None:
    """Kill a roslaunch and all its nodes at once, so that nothing is cleaned up."""
    os.kill(launch.pid, signal.SIGSTOP)  # it would restart nodes while they are being killed
    children = processes_of(launch.pid)
    kill(launch.pid)
    for number in children.values():
        kill(number)
    launch.wait()


def stored_observations(path: Path) -> int:
    """Return the number of stored observations. Raises CorruptFileError for damage."""
    if not (SessionPaths(path).observations / DATA_FILE).is_file():
        return 0
    with Session.open_read_only(path).open_observations() as store:
        return len(store)


def acknowledged(path: Path) -> int:
    """Return the number of steps in the planner's table; each was acknowledged before."""
    if not SessionPaths(path).config.is_file():
        return 0
    return len(Session.open_read_only(path).read_table("exploration")["step"])


def learn_arguments(root: Path, **more: object) -> List[str]:
    """Return arguments of learn.launch for a short run in the session "run" below a folder."""
    values = {"profile": PROFILE, "session_root": root, "session": "run", "seed": 1, **more}
    return [f"{name}:={value}" for name, value in values.items()]


def outcome(path: Path) -> Dict[str, bytes]:
    """Return tables and weights of a complete run, for comparison."""
    weights, _ = load_model(SessionPaths(path).model)
    tables = {name: (path / name).read_bytes() for name in TABLES}
    return {**tables, **{name: tensor.numpy().tobytes() for name, tensor in weights.items()}}


def crash(
    home: Path,
    path: Path,
    arguments: List[str],
    kills: int,
    seed: int,
    timeout: float,
    log: Callable[[str], object] = lambda text: None,
) -> List[Crash]:
    """Run learn.launch to its end with a number of kills; return what was killed.

    Args:
        home: folder for logs.
        path: folder of the session.
        arguments: of learn.launch.
        kills: number of kills.
        seed: of victims and times.
        timeout: [s].
        log: called with a line after each kill.

    Raises:
        AssertionError: an acknowledged observation is lost, or the run does not end within the timeout.
    """
    draw, crashes, ends_at = random.Random(seed), [], time.monotonic() + timeout
    victims = _victims(draw)
    victim = next(victims)
    variables = environment(home)
    while not is_finished(path):
        resume = ["resume:=true"] if SessionPaths(path).config.is_file() else []
        command = ["roslaunch", "embodied_active_learning", "learn.launch", *arguments, *resume, "respawn:=true"]
        with started(command, home / f"launch-{len(crashes)}.log", variables) as launch:
            while launch.poll() is None:
                assert time.monotonic() < ends_at, f"the run did not end in {timeout:g} s: {crashes}"
                if len(crashes) < kills:
                    reached = acknowledged(path) + draw.choice(STEPS_BETWEEN)
                    _wait(launch, lambda reached=reached: acknowledged(path) >= reached, ends_at)
                _wait(launch, lambda: False, time.monotonic() + draw.uniform(0.0, MAX_WAIT))
                processes = processes_of(launch.pid)
                is_running = {victim} & set(NODES) <= set(processes) and {"trainer", "ergodic_planner"} <= set(
                    processes
                )
                if launch.poll() is not None or len(crashes) >= kills or not is_running:
                    continue
                before = acknowledged(path)
                if victim == EVERYTHING:
                    kill_everything(launch)
                elif victim == FREEZE:
                    freeze(processes["ergodic_planner"])
                elif victim == INTERRUPTION:
                    launch.send_signal(signal.SIGINT)
                    launch.wait(60)
                else:
                    kill(processes[victim])
                stored = stored_observations(path)
                assert stored >= before, f"{before} observations were acknowledged, {stored} are stored"
                crashes.append(Crash(victim, stored))
                log(f"{len(crashes)} of {kills}: killed {victim} at observation {stored}")
                victim = next(victims)
    return crashes


def _victims(draw: random.Random) -> Iterator[str]:
    """Yield what to kill next: each of all victims once, in random order, repeatedly."""
    while True:
        yield from draw.sample([*NODES, EVERYTHING, INTERRUPTION, FREEZE], len(NODES) + 3)


def _wait(launch: subprocess.Popen, condition: Callable[[], bool], until: float) -> None:
    """Return when the condition holds, the launch has ended, or the time `until` is reached."""
    while launch.poll() is None and time.monotonic() < until and not condition():
        time.sleep(0.02)
