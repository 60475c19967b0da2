"""Reproduce the paper's learning-metrics figure in simulation, for several worlds, seeds and random walks.

    source setup.bash && python3 experiments/learning_metrics.py --worlds diagonal --seeds 1 2 3 --steps 1000

A run of the paper's length has 3000 steps and 9000 updates. The script can be interrupted at any time: started again,
it skips finished runs and resumes the others.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path
from typing import List, Tuple

import numpy as np

from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.figures.learning_metrics import draw_learning_metrics
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.summary import read_summary

ROOT = Path(__file__).resolve().parents[1]
Run = Tuple[str, str, int]  # world, explorer, seed


def main() -> None:
    """Complete all runs, then draw the figure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", nargs="+", default=["bottom", "diagonal", "middle", "right"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2, 3, 4])
    parser.add_argument("--random-walk-world", default="diagonal", help="world of the random walk")
    parser.add_argument("--random-walk-seeds", nargs="*", type=int, default=[0, 1, 2, 3, 4])
    parser.add_argument("--steps", type=int, default=3000)
    parser.add_argument("--root", type=Path, default=Path("~/.ros/embodied_active_learning/learning_metrics"))
    options = parser.parse_args()
    root = options.root.expanduser()
    runs = [(world, "ergodic", seed) for world in options.worlds for seed in options.seeds]
    runs += [(options.random_walk_world, "random_walk", seed) for seed in options.random_walk_seeds]
    sessions = [Session.open_read_only(complete_run(run, options.steps, root)) for run in runs]
    figure = root / "learning_metrics.png"
    draw_learning_metrics(figure, sessions)
    print("\n".join(table(runs, sessions)))
    print(figure)


def complete_run(run: Run, steps: int, root: Path) -> Path:
    """Run or resume a session unless it has finished. Return its folder; exit if the run fails."""
    world, explorer, seed = run
    path = root / f"{world}-{explorer}-{steps}-seed{seed}"
    if not has_finished(path):
        values = {"world": world, "explorer": explorer, "seed": seed, "steps": steps}
        values.update(session=path.name, session_root=root, resume=str(path.exists()).lower())
        command = [
            "bash",
            str(ROOT / "tools" / "learn.sh"),
            "profile:=demo",
            *(f"{name}:={value}" for name, value in values.items()),
        ]
        if subprocess.run(command, check=False).returncode:
            sys.exit(f"run failed: {path}; see the output above")
    return path


def has_finished(path: Path) -> bool:
    """Return whether a session exists and has finished."""
    try:
        return read_summary(path / "summary.yaml").finished
    except CorruptFileError:
        return False


def table(runs: List[Run], sessions: List[Session]) -> List[str]:
    """Return a Markdown table of the final metrics of each run; the ergodic measure is a mean over 50 steps."""
    columns = "world explorer seed ergodic_measure coverage active_units mse_own mse_shuffled mse_none log_std_range"
    lines = [f"| {columns.replace(' ', ' | ')} |", "|" + " --- |" * len(columns.split())]
    for (world, explorer, seed), session in zip(runs, sessions):
        summary = read_summary(session.paths.summary)
        measure = float(np.mean(session.read_table("exploration")["ergodic_measure"][-50:]))
        last = {name: values[-1] for name, values in session.read_table("evaluation").items()}
        numbers = [measure, summary.coverage, last["active_units"], last["mse_own"], last["mse_shuffled"]]
        numbers += [last["mse_none"], last["log_std_max"] - last["log_std_min"]]
        lines.append(f"| {world} | {explorer} | {seed} | " + " | ".join(f"{number:.4g}" for number in numbers) + " |")
    return lines


if __name__ == "__main__":
    main()
