"""Prints the preferred TCP port if it is free, else another one that is."""

import socket
import sys


def free_port(preferred: int) -> int:
    """The preferred port, or one that the system picks."""
    for port in (preferred, 0):
        with socket.socket() as probe:
            try:
                probe.bind(("", port))
            except OSError:
                continue
            return probe.getsockname()[1]
    raise OSError("no TCP port is free")


if __name__ == "__main__":
    sys.stdout.write(f"{free_port(int(sys.argv[1]))}\n")
