"""Parameters that survive a restart of their node; a dictionary takes the place of the parameter server."""

import threading

import pytest
import rospy

from embodied_active_learning.ros.runtime import persistent_parameters


class Server(dict):
    """A parameter server that may not respond."""

    def __init__(self):
        super().__init__()
        self.responds = threading.Event()
        self.responds.set()

    def set_param(self, name, value):
        self.responds.wait()
        self[name] = value


@pytest.fixture
def server(monkeypatch):
    """Without the timer: only direct calls store anything."""
    server = Server()
    monkeypatch.setattr(rospy, "get_param", server.get)
    monkeypatch.setattr(rospy, "set_param", server.set_param)
    monkeypatch.setattr(persistent_parameters, "WallTimer", lambda period, function: None)
    yield server
    server.responds.set()


@pytest.fixture
def hooks(monkeypatch):
    """Hooks that rospy calls after those of rospy.on_shutdown."""
    hooks = []
    monkeypatch.setattr(rospy.core, "add_preshutdown_hook", hooks.append)
    return hooks


def test_last_change_is_stored_at_shutdown(server, hooks):
    state = {"stopped_by": ""}
    persistent_parameters.store("~stopped_by", lambda: state["stopped_by"])
    state["stopped_by"] = "/operator"
    assert server == {}
    for hook in hooks:
        hook("signal")
    assert server == {"~stopped_by": "/operator"}


def test_change_is_stored_at_once_on_request(server, hooks):
    persistent_parameters.store("~stopped_by", lambda: "/operator")()
    assert server == {"~stopped_by": "/operator"}


def test_silent_master_does_not_block(server, hooks, monkeypatch):
    monkeypatch.setattr(persistent_parameters, "_TIMEOUT", 0.0)
    server.responds.clear()
    persistent_parameters.store("~stopped_by", lambda: "/operator")()
    assert server == {}


def test_missing_master_is_logged(server, hooks, monkeypatch):
    def refuse(name, value):
        raise ConnectionRefusedError("no master")

    lines = []
    monkeypatch.setattr(rospy, "set_param", refuse)
    monkeypatch.setattr(rospy, "logwarn", lambda text, *values: lines.append(text % values))
    persistent_parameters.store("~stopped_by", lambda: "/operator")()
    assert lines == ["parameter ~stopped_by not stored: ConnectionRefusedError('no master')"]
