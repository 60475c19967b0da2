#!/usr/bin/env python3
"""Simulates franka_ros on a real Panda, and usb_cam: the same topics, services and action, in real time.

Like franka_control.launch it runs franka_control, controller_manager and franka_state_controller; like usb_cam_node a
camera. README.md in this folder explains how to start it, its parameters and its faults.
"""

import embodied_active_learning.ros.runtime.startup  # noqa: F401  before the slow imports

import importlib
import os
import sys
from pathlib import Path

# Before numpy is imported: its second thread would spin all the time between the small matrices of this node.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from embodied_active_learning.ros.runtime.node import run_node
from fake_franka.generate import use_messages

if __name__ == "__main__":
    use_messages()
    run_node("fake_franka", importlib.import_module("fake_franka.stand_in").main)  # imports those messages
