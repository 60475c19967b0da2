"""Print the preferred TCP port if it is free, else another free one."""

import argparse
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
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("preferred", type=int, help="port")
    sys.stdout.write(f"{free_port(parser.parse_args().preferred)}\n")
