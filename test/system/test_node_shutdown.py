"""Nodes end within five seconds of SIGINT or SIGTERM, whatever they are doing, with the exit code of the reason."""

import signal
import subprocess
import sys
import xmlrpc.client
from contextlib import contextmanager
from pathlib import Path

import pytest

from embodied_active_learning.ros.runtime.shutdown import ExitCode
from launching import ROOT, environment, started
from threads import wait_for, wait_while_running

pytestmark = pytest.mark.ros

STUB = Path(__file__).with_name("stub_node.py")
WAITING = "waiting for an event that never happens"
SIGNALS = [signal.SIGINT, signal.SIGTERM]


class Node:
    """A node's process and its output."""

    def __init__(self, process, log):
        self.process = process
        self._log = log

    @property
    def output(self):
        return self._log.read_text()

    def wait_until(self, condition, timeout=60):
        wait_while_running(self.process, condition, timeout, lambda: self.output)

    def wait_for(self, words):
        self.wait_until(lambda: words in self.output)

    def end(self, sig):
        """Send a signal and return the exit code; fail after fifteen seconds, for a busy computer."""
        self.process.send_signal(sig)
        try:
            return self.process.wait(15.0)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"shutdown timeout; output:\n{self.output}") from None


class Ros:
    """A rosmaster with an empty configuration, and nodes that use it."""

    def __init__(self, home):
        self.home = home
        self.variables = environment(home)
        self.uri = self.variables["ROS_MASTER_URI"]
        self._count = 0

    @contextmanager
    def master(self, **parameters):
        port = self.uri.rsplit(":", 1)[1]
        with started(["rosmaster", "--core", "-p", port], self.home / "master.log", self.variables) as process:
            api = xmlrpc.client.ServerProxy(self.uri)

            def is_set_up():
                try:
                    for name, value in {"/config": {}, **parameters}.items():
                        api.setParam("/test", name, value)
                except OSError:
                    return False
                return True

            wait_for(is_set_up, 0.02, 60)
            try:
                yield process
            finally:
                process.kill()  # faster than an orderly shutdown

    @contextmanager
    def node(self, *command):
        self._count += 1
        log = self.home / f"node-{self._count}.log"
        with started([sys.executable, *command], log, {**self.variables, "PYTHONUNBUFFERED": "1"}) as process:
            try:
                yield Node(process, log)
            finally:
                process.kill()

    @property
    def api(self):
        return xmlrpc.client.ServerProxy(self.uri)

    def set_parameter(self, name, value):
        self.api.setParam("/test", name, value)

    def parameter(self, name):
        return self.api.getParam("/test", name)[2]


@pytest.fixture(scope="module")
def ros(tmp_path_factory):
    return Ros(tmp_path_factory.mktemp("endings"))


@pytest.fixture(scope="module")
def master(ros):
    with ros.master() as process:
        yield process


@pytest.mark.parametrize("sig", SIGNALS)
def test_waiting_node_ends_at_once(ros, master, sig):
    with ros.node(STUB, "wait") as node:
        node.wait_for(WAITING)
        assert node.end(sig) == ExitCode.SUCCESS
        assert "Traceback" not in node.output


def test_node_publishes_while_topics_close(ros, master):
    with ros.node(STUB, "publish_while_topics_close") as node:
        node.wait_for(WAITING)
        assert node.end(signal.SIGINT) == ExitCode.SUCCESS
        assert "published" in node.output
        assert "Traceback" not in node.output


@pytest.mark.parametrize("sig", SIGNALS)
def test_node_ends_during_call_of_master(ros, master, sig):
    with ros.node(STUB, "call_master") as node:
        node.wait_for("calling the master")
        assert node.end(sig) == ExitCode.SUCCESS


def test_computing_node_is_ended_after_timeout(ros, master):
    with ros.node(STUB, "compute") as node:
        node.wait_for("computing")
        assert node.end(signal.SIGINT) == ExitCode.SHUTDOWN_TIMEOUT
        assert "/stub: shutdown timeout: still running after 4 s" in node.output


def test_node_computing_in_service_ends(ros, master):
    with ros.node(STUB, "compute_in_a_service") as node, caller(ros):
        node.wait_for("computing")
        assert node.end(signal.SIGTERM) in (ExitCode.SUCCESS, ExitCode.SHUTDOWN_TIMEOUT)


@contextmanager
def caller(ros):
    """A client of the computing service, which never responds."""
    with ros.node(STUB, "call_computing_service", "__name:=caller") as node:
        yield node


def test_node_waiting_for_response_ends_at_once(ros, master):
    with ros.node(STUB, "compute_in_a_service") as server, caller(ros) as node:
        server.wait_for("computing")
        assert node.end(signal.SIGINT) == ExitCode.SUCCESS


def test_node_without_master_ends_at_once(tmp_path):
    ros = Ros(tmp_path)
    with ros.node(STUB, "wait") as node:
        node.wait_for(f"waiting for the ROS master at {ros.uri}: [Errno 111] Connection refused")
        assert node.end(signal.SIGINT) == -signal.SIGINT
        assert "Traceback" not in node.output


def test_node_ends_while_master_hangs(tmp_path):
    ros = Ros(tmp_path)
    with ros.master() as master, ros.node(STUB, "wait") as node:
        node.wait_for(WAITING)
        master.send_signal(signal.SIGSTOP)
        assert node.end(signal.SIGINT) in (ExitCode.SUCCESS, ExitCode.SHUTDOWN_TIMEOUT)
        assert "Traceback" not in node.output


def test_known_error_is_last_line_and_failure_parameter(ros, master):
    with ros.node(STUB, "refuse") as node:
        assert node.process.wait(60) == ExitCode.KNOWN_ERROR
        assert node.output.splitlines()[-1].endswith("the disk is full: free some")
        assert "Traceback" not in node.output
        assert ros.parameter("/failure") == "/stub: the disk is full: free some"


def test_unexpected_error_shows_traceback(ros, master):
    with ros.node(STUB, "fail") as node:
        assert node.process.wait(60) == ExitCode.UNEXPECTED_ERROR
        assert "ZeroDivisionError" in node.output


def test_node_logs_missing_clock(tmp_path):
    ros = Ros(tmp_path)
    with ros.master(**{"/use_sim_time": True}), ros.node(STUB, "wait", "needs_clock") as node:
        node.wait_for("waiting for /clock: /use_sim_time is true, but no node publishes it")
        assert node.end(signal.SIGINT) == ExitCode.SUCCESS


def test_fingerprinter_of_stored_images_needs_no_clock(tmp_path):
    ros = Ros(tmp_path)
    parameters = {
        "/use_sim_time": True,  # left by a simulation
        "/config": {"session": {"root": str(tmp_path), "name": "missing"}},
        "/fingerprinter/once": True,
        "/fingerprinter/views_from": "stored",
    }
    with ros.master(**parameters), ros.node(ROOT / "nodes" / "fingerprinter") as node:
        node.wait_until(lambda: "missing" in node.output or "/clock" in node.output)
        assert "/clock" not in node.output
        assert node.process.wait(60) == ExitCode.KNOWN_ERROR


@pytest.mark.parametrize(("name", "library"), [("trainer", "libtorch"), ("identifier", "libtorch")])
def test_node_ends_silently_during_imports(ros, master, name, library):
    with ros.node(ROOT / "nodes" / name) as node:
        node.wait_until(lambda: library in Path(f"/proc/{node.process.pid}/maps").read_text())
        assert node.end(signal.SIGINT) == -signal.SIGINT
        assert node.output == ""


def test_failed_node_ends_monitor_with_reason(ros, master):
    ros.set_parameter("/failure", "")
    with ros.node(ROOT / "nodes" / "monitor") as monitor:  # required by the launch
        monitor.wait_for("waiting for /training_status")
        with ros.node(STUB, "refuse") as node:
            assert node.process.wait(60) == ExitCode.KNOWN_ERROR
        assert monitor.process.wait(60) == ExitCode.KNOWN_ERROR
        assert monitor.output.splitlines()[-1].endswith("/stub: the disk is full: free some")
        assert "Traceback" not in monitor.output


def test_running_node_is_not_replaced(tmp_path):
    """A second node or launch with the same name does not start; a killed node is replaced."""
    ros = Ros(tmp_path)
    parameters = {"/config": {"session": {"name": "first"}}, "/failure": ""}
    with ros.master(**parameters), ros.node(STUB, "wait") as first:
        first.wait_for(WAITING)
        with ros.node(STUB, "wait") as second:
            assert second.process.wait(60) == ExitCode.KNOWN_ERROR
            where = f"(process {first.process.pid} on localhost, session first)"
            assert f"node /stub is already running {where}" in second.output
        with ros.node(ROOT / "scripts" / "resolve_config", "--nodes", "trainer", "stub") as launch:
            assert launch.process.wait(60) == ExitCode.KNOWN_ERROR
            assert "nothing was started: node /stub is already running" in launch.output
        assert ros.parameter("/failure") == ""
        assert first.process.poll() is None
        first.process.kill()
        with ros.node(STUB, "wait") as third:
            third.wait_for(WAITING)
