#!/usr/bin/env python3
"""A node whose first argument names the function it runs."""

import embodied_active_learning.ros.runtime.startup  # noqa: F401

import sys

import numpy as np
import rospy
from std_msgs.msg import Empty
from std_srvs.srv import Trigger

from embodied_active_learning.errors import SessionError
from embodied_active_learning.ros.runtime.diagnostics import Health, report_health
from embodied_active_learning.ros.runtime.node import publish, run_node, wait_until
from embodied_active_learning.ros.runtime.services import RetryingService


def compute(_request=None):
    """Run linear algebra for ever; each call takes seconds and cannot be interrupted."""
    rospy.loginfo("computing")
    while True:
        np.linalg.eigvals(np.random.default_rng(0).standard_normal((1200, 1200)))


def compute_in_a_service():
    rospy.Service("compute", Trigger, compute)
    rospy.spin()


def refuse():
    raise SessionError("the disk is full: free some")


def fail():
    raise ZeroDivisionError


def wait():
    report_health("stub", lambda: Health(message="working"))
    wait_until(lambda: False, lambda: "an event that never happens")


def call_master():
    """Call the master all the time, so that a signal arrives during a call."""
    rospy.loginfo("calling the master")
    while not rospy.is_shutdown():
        rospy.get_published_topics()


def publish_while_topics_close():
    topic = rospy.Publisher("topic", Empty, queue_size=1)
    rospy.core.add_preshutdown_hook(lambda _reason: (publish(topic, Empty()), rospy.loginfo("published")))
    wait()


def call_computing_service():
    RetryingService("compute", Trigger).call(Trigger._request_class())


if __name__ == "__main__":
    body = globals()[sys.argv[1]]
    run_node("stub", lambda _config: body(), needs_clock="needs_clock" in sys.argv)
