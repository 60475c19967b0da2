"""Found objects as poses and tf frames."""

from __future__ import annotations

import math

import numpy as np
import rospy
from std_msgs.msg import Header

from embodied_active_learning.objects.fingerprint import BLANK
from embodied_active_learning.ros.conversions import pose_message
from embodied_active_learning.ros.objects.found_objects import found_objects, frame_message
from sample_decisions import make_decision


def test_blanks_and_rejected_candidates_are_left_out():
    decisions = [make_decision(), make_decision(kind=BLANK), make_decision(instance=0)]
    assert found_objects(decisions) == decisions[:1]


def test_pose_lies_on_table_with_yaw_as_quaternion():
    pose = pose_message(np.array([0.5, -0.1, math.pi / 2.0]))
    assert (pose.position.x, pose.position.y, pose.position.z) == (0.5, -0.1, 0.0)
    quaternion = pose.orientation
    np.testing.assert_allclose(
        (quaternion.x, quaternion.y, quaternion.z, quaternion.w), (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))
    )


def test_frame_is_named_by_session_fingerprint_and_instance():
    header = Header(stamp=rospy.Time(3), frame_id="panda_link0")
    message = frame_message(header, make_decision(session="table", instance=2, pose=(0.5, -0.1, 0.0)))
    assert (message.header.frame_id, message.child_frame_id) == ("panda_link0", "found/table/object-1/2")
    assert (message.transform.translation.x, message.transform.translation.y) == (0.5, -0.1)
