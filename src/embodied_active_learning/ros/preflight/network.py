"""Checks of network addresses: of this computer, and of the other nodes."""

from __future__ import annotations

from typing import Mapping, NamedTuple, Sequence

from embodied_active_learning.ros.preflight.check_result import CheckResult, error, ok, warning


class Peer(NamedTuple):
    """Another node: its advertised host, and why it does not respond (empty if it does)."""

    name: str
    host: str
    connection_error: str
    local: bool


class OwnAddress(NamedTuple):
    """Address that this computer advertises, and those that it has."""

    host: str
    is_loopback: bool
    is_local: bool  # whether the host is one of the addresses
    addresses: Sequence[str]


def check_own_address(
    own: OwnAddress, environment: Mapping[str, str], master_is_local: bool, peers: Sequence[Peer]
) -> CheckResult:
    """Check that other computers reach this one at the address from ROS_IP, ROS_HOSTNAME or the host name."""
    name = "own address"
    given = {key: environment[key] for key in ("ROS_HOSTNAME", "ROS_IP") if environment.get(key)}
    origin = ", ".join(f"{key}={value}" for key, value in given.items()) or "neither ROS_IP nor ROS_HOSTNAME is set"
    single_computer = master_is_local and all(peer.local for peer in peers)
    if own.is_loopback and not single_computer:
        return error(
            name,
            f"this computer advertises {own.host} ({origin})",
            "nodes on other computers connect to themselves instead of to this computer",
            "unset ROS_HOSTNAME; export ROS_IP=address of this computer in the common network; restart all nodes",
        )
    if given and not own.is_local:
        return error(
            name,
            f"{origin} is not an address of this computer, which has {', '.join(own.addresses)}",
            "other nodes connect to a wrong address, so topics arrive in one direction only",
            "unset ROS_HOSTNAME ROS_IP, or export ROS_IP with one of these addresses; restart all nodes",
        )
    if len(given) == 2:
        return warning(name, origin, "ROS_HOSTNAME takes precedence; ROS_IP is ignored", "unset ROS_HOSTNAME")
    if not given and not single_computer:
        return warning(
            name,
            f"this computer advertises {own.host} ({origin})",
            "if other computers cannot resolve the name, topics arrive in one direction only",
            "export ROS_IP=own address in the common network, on every computer",
        )
    return ok(name, f"{own.host} ({origin})")


def check_peers(peers: Sequence[Peer]) -> CheckResult:
    """Check that every node of the graph responds."""
    silent = [f"{peer.name} at {peer.host} ({peer.connection_error})" for peer in peers if peer.connection_error]
    if silent:
        return error(
            "other nodes",
            f"no connection to {'; '.join(silent)}",
            "their topics and services do not work from this computer",
            "set ROS_IP on their computer and restart them; remove dead nodes with rosnode cleanup",
        )
    remote = [peer for peer in peers if not peer.local]
    hosts = ", ".join(sorted({peer.host for peer in remote}))
    where = f", {len(remote)} of them on {hosts}" if remote else ", all on this computer"
    return ok("other nodes", f"{len(peers)} respond{where}")
