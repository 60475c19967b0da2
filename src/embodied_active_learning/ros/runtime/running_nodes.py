"""Protection of running nodes: ROS ends a node when another one registers with its name."""

from __future__ import annotations

import sys
from typing import Sequence
from urllib.parse import urlparse

import rosgraph

from embodied_active_learning.errors import BusyError
from embodied_active_learning.hardware_config import ARMS
from embodied_active_learning.ros import names
from embodied_active_learning.ros.runtime.master import CALL_ERRORS, server_proxy

ARM_NODES = (*(arm.node for arm in ARMS.values()), "camera_pipeline")
"""Nodes of all arms and of their cameras."""


def own_name(default: str) -> str:
    """Return the name with which this process will register: from its arguments and environment, or the default."""
    mappings = rosgraph.names.load_mappings(sys.argv)
    return rosgraph.names.ns_join(rosgraph.names.get_ros_namespace(), mappings.get("__name", default))


def require_unused_names(nodes: Sequence[str], remedy: str = "") -> None:
    """Raise BusyError if a node with one of these names is running. Relative names are resolved with ROS_NAMESPACE.

    Nodes that do not respond, for example because they were killed, may be replaced. remedy: appended to the message.
    """
    caller = rosgraph.names.make_caller_id("require_unused_names")
    config = rosgraph.names.resolve_name(names.CONFIG_PARAMETER, caller)
    master = server_proxy(rosgraph.get_master_uri())
    for node in nodes:
        name = rosgraph.names.resolve_name(node, caller)
        try:
            code, _, uri = master.lookupNode(caller, name)
            if code != 1:
                continue
            _, _, pid = server_proxy(uri).getPid(caller)
            _, _, session = master.getParam(caller, f"{config}/session")
        except CALL_ERRORS:
            continue
        session_name = session.get("name") if isinstance(session, dict) else None
        where = f"process {pid} on {urlparse(uri).hostname}, session {session_name or '-'}"
        raise BusyError(
            f"node {name} is already running ({where}): wait until that run has ended, or start this one with another "
            f"ROS_NAMESPACE or ROS_MASTER_URI{remedy}"
        )
