"""Print the preferred TCP port if it is free, else another free one."""

import socket
import sys


def free_port(preferred: int) -> int:
    """Return the preferred port, or one chosen by the system."""
    for port in (preferred, 0):
        with socket.socket() as probe:
            try:
                probe.bind(("", port))
            except OSError:
                continue
            return probe.getsockname()[1]
    raise OSError("no free TCP port")


if __name__ == "__main__":
    sys.stdout.write(f"{free_port(int(sys.argv[1]))}\n")
