"""Helpers for real-time tests on the stand-in for franka_ros."""

import json
import os
import subprocess

import yaml

from fake_franka.generate import DEFAULT_FOLDER, generate
from launching import ROOT, started

FAKE = ROOT / "test" / "fake_franka" / "fake_franka.launch"


def with_franka_messages(variables):
    """Return an environment in which franka_msgs can be imported, installed or generated."""
    generate(DEFAULT_FOLDER)
    return {**variables, "PYTHONPATH": f"{variables.get('PYTHONPATH', '')}{os.pathsep}{DEFAULT_FOLDER}"}


def stand_in(home, variables, *arguments, prefix=()):
    """Start the stand-in's launch file once a master is available; its output goes to home/robot.log."""
    command = [*prefix, "roslaunch", "--wait", "--sigint-timeout=10", FAKE, *arguments]
    return started(list(map(str, command)), home / "robot.log", variables)


def call(variables, service, request="{}", prefix=()):
    """Call a service with rosservice and return its output."""
    command = [*prefix, "rosservice", "call", "--wait", service, request]
    return subprocess.run(command, env=variables, check=True, capture_output=True, text=True, timeout=60).stdout


def truth(variables, prefix=()):
    """Return the true motion of the stand-in since the last call."""
    response = yaml.safe_load(call(variables, "/fake_franka/truth", prefix=prefix))
    return json.loads(response["message"])
