"""Forks writers that are there to be killed: one of everything in turn, and a line for each that was acknowledged.

killed_writer.py ROOT: for every line on its input a writer is forked; its number is told, then what it has written, and
"ended" when it was killed. Forked, because importing takes longer than a life.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import torch

from embodied_active_learning.session import disk
from embodied_active_learning.session.checkpoints import save_checkpoint, save_model
from embodied_active_learning.session.fingerprints import save_fingerprints
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.summary import summarise, write_summary
from sample_session import configuration, fingerprints, network, observation


def tell(what: str, number: int) -> None:
    """Say that it is written; a pipe takes a short line whole, and keeps it when the writer is killed."""
    os.write(1, f"{what} {number}\n".encode())


def write_for_ever(root: Path, resume: bool) -> None:
    """Go on with the session, or begin it."""
    config = configuration(root, resume=resume)
    weights = network(config).state_dict()
    session = Session.open_for_writing(config)
    store, table = session.open_observations(), session.open_table("training")
    while True:
        number = len(store)
        store.append(*observation(number))
        tell("observation", number)
        table.append({"update": number, "loss": number / 7})
        tell("row", number)
        counted = {name: torch.full_like(tensor, number) for name, tensor in weights.items()}
        save_checkpoint(session.paths.checkpoints, number + 1, counted, {"number": number})
        tell("checkpoint", number)
        save_model(session.paths.model, counted, {"updates": number, "observations": number})
        tell("model", number)
        save_fingerprints(session.paths.path, fingerprints(config, number))
        tell("fingerprints", number)
        write_summary(session.paths.summary, summarise(session, False, number))
        tell("summary", number)


def main(root: Path) -> None:
    """Fork a writer for every line, and bury it."""
    torch.set_num_threads(1)
    disk.SPARE_BYTES = 0
    tell("ready", 0)
    for _ in sys.stdin:
        child = os.fork()
        if child == 0:
            tell("writer", os.getpid())
            write_for_ever(root, resume=(root / "sample" / "config.yaml").exists())
        os.waitpid(child, 0)
        tell("ended", child)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
