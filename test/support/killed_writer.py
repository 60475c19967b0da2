"""Forks writers to be killed, and reports the files that each has written before.

For every input line, "ROOT" or "ROOT PART BYTE", it forks a writer and prints its process id, a line for each
acknowledged file, and "ended" once it is dead. The writer writes one file of each kind in turn until it is killed; or
that part only, and the kernel kills it when it writes beyond that byte of any file. Forking avoids the slow imports.
"""

from __future__ import annotations

import os
import resource
import signal
import sys
from pathlib import Path
from typing import Dict

import torch

from embodied_active_learning.session import disk
from embodied_active_learning.session.checkpoints import save_checkpoint, save_model
from embodied_active_learning.session.conclusion import summarise
from embodied_active_learning.session.fingerprints import save_fingerprints
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.summary import write_summary
from sample_session import NAME, configuration, fingerprints, network, observation

PARTS = ("observation", "row", "checkpoint", "model", "fingerprints", "summary")


def report(what: str, number: int) -> None:
    """Report what is written; a pipe takes a short line whole, and keeps it when the writer is killed."""
    os.write(1, f"{what} {number}\n".encode())


class Writer:
    """Resumes the session, or creates it."""

    def __init__(self, root: Path) -> None:
        self._config = configuration(root, resume=(root / NAME / "config.yaml").exists())
        self._weights = network(self._config).state_dict()
        self._session = Session.open_for_writing(self._config)
        self._store = self._session.open_observations()
        self._table = self._session.open_table("training")

    def write(self, part: str) -> None:
        """Write a part containing the number of observations, and report it."""
        number = len(self._store)
        getattr(self, f"_write_{part}")(number)
        report(part, number)

    def _write_observation(self, number: int) -> None:
        self._store.append(*observation(number))

    def _write_row(self, number: int) -> None:
        self._table.append({"update": number, "loss": number / 7})

    def _write_checkpoint(self, number: int) -> None:
        folder = self._session.paths.checkpoints
        save_checkpoint(folder, number + 1, number, self._numbered(number), {"number": number})

    def _write_model(self, number: int) -> None:
        facts = {"updates": number, "observations": number}
        save_model(self._session.paths.model, self._numbered(number), facts)

    def _write_fingerprints(self, number: int) -> None:
        save_fingerprints(self._session.paths.path, fingerprints(self._config, number))

    def _write_summary(self, number: int) -> None:
        write_summary(self._session.paths.summary, summarise(self._session, False, number))

    def _numbered(self, number: int) -> Dict[str, torch.Tensor]:
        return {name: torch.full_like(tensor, number) for name, tensor in self._weights.items()}


def live(root: Path, part: str = "", byte: str = "") -> None:
    """The life of a forked writer."""
    report("writer", os.getpid())
    if not part:
        writer = Writer(root)
        while True:
            for each in PARTS:
                writer.write(each)
    if part == "config":
        die_at_byte(int(byte))
        Writer(root)
    else:
        writer = Writer(root)
        die_at_byte(int(byte))
        writer.write(part)


def die_at_byte(byte: int) -> None:
    """Be killed by the first write that goes beyond this byte of a file; what lies before it is written."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (byte, byte))
    signal.signal(signal.SIGXFSZ, signal.SIG_DFL)


def main() -> None:
    """Fork a writer for every line, and wait until it is dead."""
    torch.set_num_threads(1)
    disk.SPARE_BYTES = 0
    report("ready", 0)
    for line in sys.stdin:
        child = os.fork()
        if child == 0:
            root, *wish = line.split()
            live(Path(root), *wish)
            os._exit(0)
        os.waitpid(child, 0)
        report("ended", child)


if __name__ == "__main__":
    main()
