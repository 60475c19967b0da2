#!/usr/bin/env python3
"""A node that does one thing, named by its first argument, until it is asked to end, or for ever."""

import embodied_active_learning.ros.runtime.interruptible  # noqa: F401

import subprocess
import sys

import numpy as np
import rospy
from std_msgs.msg import Empty
from std_srvs.srv import Trigger

from embodied_active_learning.errors import SessionError
from embodied_active_learning.ros.runtime.diagnostics import Health, report_health
from embodied_active_learning.ros.runtime.failure import FailureWatch
from embodied_active_learning.ros.runtime.node import publish, run_node, wait_until
from embodied_active_learning.ros.runtime.services import RetryingService


def compute(_request=None):
    """Linear algebra that nobody interrupts: each call takes seconds, and there is always another one."""
    rospy.loginfo("computing")
    while True:
        np.linalg.eigvals(np.random.default_rng(0).standard_normal((1200, 1200)))


def compute_beside_a_child():
    child = subprocess.Popen(["sleep", "1000"])
    rospy.loginfo("child %d", child.pid)
    compute()


def compute_in_a_service():
    rospy.Service("compute", Trigger, compute)
    rospy.spin()


def refuse():
    raise SessionError("the disk is full: free some")


def fail():
    raise ZeroDivisionError


def wait():
    report_health("stub", lambda: Health(message="working"))
    wait_until(lambda: False, lambda: "something that never comes")


def publish_while_its_topics_are_closed():
    told = rospy.Publisher("told", Empty, queue_size=1)
    rospy.core.add_preshutdown_hook(lambda _reason: (publish(told, Empty()), rospy.loginfo("published")))
    wait()


def go_on_while_the_run_can():
    failure = FailureWatch(lambda: "no progress")
    rospy.loginfo("watching")
    rospy.spin()
    failure.check()


def call_one_who_does_not_answer():
    RetryingService("compute", Trigger).call(Trigger._request_class())


if __name__ == "__main__":
    body = globals()[sys.argv[1]]
    run_node("stub", lambda _config: body(), needs_clock="needs_clock" in sys.argv)
