"""learn.launch robot:=franka against the stand-in for franka_ros, in real time."""

from itertools import combinations

import numpy as np
import pytest

from embodied_active_learning.ros.bags.recording import Recording
from embodied_active_learning.session.session import Session
from launching import ROOT, Run, environment, launched, started
from real_time import call, stand_in, truth, with_franka_messages

pytestmark = pytest.mark.ros

STEPS = 30
PROFILE = ROOT / "test" / "rostest" / "real_time.yaml"


def test_run_completes_after_camera_froze(tmp_path):
    variables = with_franka_messages(environment(tmp_path))
    arguments = {
        "robot": "franka",
        "bringup": "nodes",
        "profile": PROFILE,
        "steps": STEPS,
        "session": "run",
        "session_root": tmp_path,
        "record": "true",
    }
    words = [f"{name}:={value}" for name, value in arguments.items()]
    port = variables["ROS_MASTER_URI"].rsplit(":", 1)[1]
    fake = stand_in(tmp_path, variables, f"profile:={PROFILE}", "encoding:=yuv422_yuy2")
    learning = launched(tmp_path, "--wait", "learn.launch", *words, variables=variables)
    with started(["roscore", "-p", port], tmp_path / "core.log", variables), fake, learning as process:
        run = Run(tmp_path, "run", process, variables)
        run.wait_for(lambda: run.steps >= 10)
        call(variables, "/fake_franka/freeze_camera", "{data: true}")
        run.wait_for(lambda: "arm held still" in run.log)
        call(variables, "/fake_franka/freeze_camera", "{data: false}")
        process.wait(180)
        motion = truth(variables)
    log = run.log
    assert "finished" in log, log
    assert "shutdown timeout" not in log
    assert "Traceback" not in log
    session = Session.open_read_only(run.path)
    assert session.config.arm.robot == "franka"
    limits = session.config.arm
    assert motion["reflexes"] == 0
    assert motion["max_outside"] < 0.003, "m; an impedance controller overshoots slightly"
    assert motion["max_speed"] < 1.2 * np.hypot(limits.max_speed, limits.max_speed), "along x and y at once"
    assert session.read_table("exploration")["step"].tolist() == list(range(1, STEPS + 1))
    with session.open_observations() as store:
        seen = store.snapshot()
    assert len(seen.images) == STEPS
    recorded = list(Recording(run.path / "bags").observations(session.config))
    assert [item.image.data for item in recorded] == [image.tobytes() for image in seen.images]
    assert not list(_repeated(seen.images, seen.raw_states)), "a frozen image was stored"


def _repeated(images, states):
    """Yield pairs of observations with the same image from different poses."""
    for (one, image), (other, again) in combinations(enumerate(images), 2):
        moved = np.abs(states[one] - states[other])
        if np.array_equal(image, again) and (moved > [2e-3, 2e-3, 2e-2]).any():
            yield one, other
