"""Every node ends within five seconds of SIGINT or SIGTERM, whatever it is doing, and its exit code tells why."""

import re
import signal
import subprocess
import sys
import time
import xmlrpc.client
from contextlib import contextmanager
from pathlib import Path

import pytest

from embodied_active_learning.ros.runtime.shutdown import ExitCode, children
from launching import ROOT, environment, started

STUB = Path(__file__).with_name("stub_node.py")
SIGNALS = [signal.SIGINT, signal.SIGTERM]


class Node:
    """A node's process, and what it has said."""

    def __init__(self, process, log):
        self.process = process
        self._log = log

    @property
    def said(self):
        return self._log.read_text()

    def wait_until(self, condition, timeout=60):
        ends_at = time.monotonic() + timeout
        while not condition():
            assert self.process.poll() is None, self.said
            assert time.monotonic() < ends_at, self.said
            time.sleep(0.02)

    def wait_for(self, words):
        self.wait_until(lambda: words in self.said)

    def end(self, sig):
        """Send a signal -> exit code, when it comes within five seconds."""
        self.process.send_signal(sig)
        try:
            return self.process.wait(5.0)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"it did not end in time, and said:\n{self.said}") from None


class Ros:
    """A bare master, with the configuration of a run, and nodes beside it."""

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
            ends_at = time.monotonic() + 20
            while True:
                try:
                    for name, value in {"/config": {}, **parameters}.items():
                        api.setParam("/test", name, value)
                    break
                except OSError:
                    assert time.monotonic() < ends_at
                    time.sleep(0.02)
            try:
                yield process
            finally:
                process.kill()  # it need not end in order, and takes its time

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
def test_a_node_that_waits_ends_at_once(ros, master, sig):
    with ros.node(STUB, "wait") as node:
        node.wait_for("waiting for something that never comes")
        assert node.end(sig) == ExitCode.ENDED
        assert "Traceback" not in node.said


def test_a_node_may_publish_while_its_topics_are_being_closed(ros, master):
    with ros.node(STUB, "publish_while_its_topics_are_closed") as node:
        node.wait_for("waiting for something that never comes")
        assert node.end(signal.SIGINT) == ExitCode.ENDED
        assert "published" in node.said
        assert "Traceback" not in node.said


def test_a_node_that_computes_is_ended_and_says_so_and_what_it_has_started_ends_with_it(ros, master):
    with ros.node(STUB, "compute_beside_a_child") as node:
        node.wait_for("computing")
        (child,) = children(node.process.pid)
        assert node.end(signal.SIGINT) == ExitCode.OVERDUE
        assert "/stub did not end by itself within 4 s" in node.said
        assert not runs(child)


def test_a_node_that_computes_for_a_call_ends(ros, master):
    with ros.node(STUB, "compute_in_a_service") as node, caller(ros):
        node.wait_for("computing")
        assert node.end(signal.SIGTERM) in (ExitCode.ENDED, ExitCode.OVERDUE)


@contextmanager
def caller(ros):
    """Somebody who calls the computing service, and ends when asked although there is no answer."""
    with ros.node(STUB, "call_one_who_does_not_answer", "__name:=caller") as node:
        yield node


def test_a_node_that_waits_for_an_answer_ends_at_once(ros, master):
    with ros.node(STUB, "compute_in_a_service") as server, caller(ros) as node:
        server.wait_for("computing")
        assert node.end(signal.SIGINT) == ExitCode.ENDED


def runs(process):
    """Whether a process is there and has not ended; one that has may wait for somebody who asks how."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def test_a_node_that_cannot_reach_the_master_ends_at_once(tmp_path):
    ros = Ros(tmp_path)
    with ros.node(STUB, "wait") as node:
        node.wait_for(f"waiting for the ROS master at {ros.uri}: [Errno 111] Connection refused")
        assert node.end(signal.SIGINT) == -signal.SIGINT
        assert "Traceback" not in node.said


def test_a_master_that_does_not_answer_is_waited_for_but_does_not_keep_a_node_from_ending(tmp_path):
    ros = Ros(tmp_path)
    with ros.master() as master, ros.node(STUB, "wait") as node:
        node.wait_for("waiting for something that never comes")
        master.send_signal(signal.SIGSTOP)
        node.wait_for(f"waiting for the ROS master at {ros.uri}: timed out")
        master.send_signal(signal.SIGCONT)
        node.wait_for("answers again")
        master.send_signal(signal.SIGSTOP)
        assert node.end(signal.SIGINT) in (ExitCode.ENDED, ExitCode.OVERDUE)
        assert "Traceback" not in node.said


def test_a_node_ends_when_the_master_was_restarted(tmp_path):
    ros = Ros(tmp_path)
    with ros.node(STUB, "wait") as node:
        with ros.master():
            node.wait_for("waiting for something that never comes")
        with ros.master():
            assert node.process.wait(20) == ExitCode.MASTER_LOST
        assert "was restarted and does not know /stub any more" in node.said


def test_a_node_ends_when_the_master_was_restarted_even_if_the_new_one_has_heard_of_it(tmp_path):
    ros = Ros(tmp_path)
    with ros.node(STUB, "wait") as node:
        with ros.master():
            node.wait_for("waiting for something that never comes")
            uri = ros.api.lookupNode("/test", "/stub")[2]
        with ros.master():
            ros.api.subscribeParam("/stub", uri, "/any")  # what rospy does when a node reads a cached parameter
            assert node.process.wait(20) == ExitCode.MASTER_LOST
        assert "was restarted and does not know /stub any more" in node.said


def test_a_named_error_is_the_last_line_and_is_left_for_others_to_see(ros, master):
    with ros.node(STUB, "refuse") as node:
        assert node.process.wait(20) == ExitCode.REFUSED
        assert node.said.splitlines()[-1].endswith("the disk is full: free some")
        assert "Traceback" not in node.said
        assert ros.parameter("/failure") == "/stub: the disk is full: free some"


def test_an_error_without_a_name_shows_where_it_happened(ros, master):
    with ros.node(STUB, "fail") as node:
        assert node.process.wait(20) == ExitCode.UNFORESEEN
        assert "ZeroDivisionError" in node.said


def test_a_node_that_needs_a_clock_says_that_there_is_none(tmp_path):
    ros = Ros(tmp_path)
    with ros.master(**{"/use_sim_time": True}), ros.node(STUB, "wait", "needs_clock") as node:
        node.wait_for("waiting for /clock: /use_sim_time is true but nobody publishes it")
        assert node.end(signal.SIGINT) == ExitCode.ENDED


def test_fingerprints_of_stored_images_wait_for_no_clock(tmp_path):
    ros = Ros(tmp_path)
    parameters = {
        "/use_sim_time": True,  # left by a simulation
        "/config": {"session": {"root": str(tmp_path), "name": "nothing-there"}},
        "/fingerprinter/once": True,
        "/fingerprinter/views_from": "stored",
    }
    with ros.master(**parameters), ros.node(ROOT / "nodes" / "fingerprinter") as node:
        node.wait_until(lambda: "nothing-there" in node.said or "/clock" in node.said)
        assert "/clock" not in node.said
        assert node.process.wait(20) == ExitCode.REFUSED


@pytest.mark.parametrize(("name", "library"), [("trainer", "libtorch"), ("identifier", "libtorch")])
def test_a_node_that_is_still_being_imported_ends_without_a_traceback(ros, master, name, library):
    with ros.node(ROOT / "nodes" / name) as node:
        node.wait_until(lambda: library in Path(f"/proc/{node.process.pid}/maps").read_text())
        assert node.end(signal.SIGINT) == -signal.SIGINT
        assert node.said == ""


def test_a_node_that_gives_up_ends_the_launch_with_its_reason(ros, master):
    ros.set_parameter("/failure", "")
    with ros.node(ROOT / "nodes" / "monitor") as monitor:  # the launch ends with it
        monitor.wait_for("waiting for /training_status")
        with ros.node(STUB, "refuse") as node:
            assert node.process.wait(20) == ExitCode.REFUSED
        assert monitor.process.wait(10) == ExitCode.REFUSED
        assert monitor.said.splitlines()[-1].endswith("/stub: the disk is full: free some")
        assert "Traceback" not in monitor.said


def test_a_node_that_is_started_again_and_again_in_vain_ends_the_launch(ros, master):
    ros.set_parameter("/failure", "")
    with ros.node(STUB, "go_on_while_the_run_can", "__name:=keeper") as keeper:
        keeper.wait_for("watching")
        starts = 1
        while keeper.process.poll() is None:
            assert starts < 100, "nobody has noticed"
            ros.set_parameter("/starts/stub", starts)
            starts += 1
            time.sleep(0.2)
        assert keeper.process.returncode == ExitCode.REFUSED
        assert 10 <= int(re.search("stub was started again ([0-9]+) times without any progress", keeper.said)[1]) < 20
