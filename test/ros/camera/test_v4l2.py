"""Controls of a v4l2 camera, read from the output of v4l2-ctl under kernels before and after Linux 5.16."""

import stat

import pytest

from embodied_active_learning.errors import RobotError
from embodied_active_learning.ros.camera.v4l2 import (
    differing_settings,
    parse_controls,
    read_controls,
    set_command,
    wanted_settings,
)

PARAMETERS = {"exposure": 166, "focus": 0, "white_balance": 4000, "video_device": "/dev/video0"}
NEW = """
User Controls

                     brightness 0x00980900 (int)    : min=0 max=255 step=1 default=128 value=128
        white_balance_automatic 0x0098090c (bool)   : default=1 value=0
      white_balance_temperature 0x0098091a (int)    : min=2000 max=6500 step=1 default=4000 value=4000

Camera Controls

                  auto_exposure 0x009a0901 (menu)   : min=0 max=3 default=3 value=3 (Aperture Priority Mode)
         exposure_time_absolute 0x009a0902 (int)    : min=3 max=2047 step=1 default=250 value=250 flags=inactive
                 focus_absolute 0x009a090a (int)    : min=0 max=250 step=5 default=0 value=0
     focus_automatic_continuous 0x009a090c (bool)   : default=1 value=0
"""
OLD = """
 white_balance_temperature_auto 0x0098090c (bool)   : default=1 value=1
      white_balance_temperature 0x0098091a (int)    : min=2000 max=6500 step=1 default=4000 value=4000
                  exposure_auto 0x009a0901 (menu)   : min=0 max=3 default=3 value=1 (Manual Mode)
              exposure_absolute 0x009a0902 (int)    : min=3 max=2047 step=1 default=250 value=166
"""


def test_differing_controls_of_new_kernels():
    differing = differing_settings(parse_controls(NEW), wanted_settings(PARAMETERS))
    assert differing == {"auto_exposure": (3, 1), "exposure_time_absolute": (250, 166)}
    assert set_command("/dev/video0", differing) == (
        "v4l2-ctl --device /dev/video0 --set-ctrl auto_exposure=1,exposure_time_absolute=166"
    )


def test_differing_controls_of_old_kernels_without_focus():
    differing = differing_settings(parse_controls(OLD), wanted_settings(PARAMETERS))
    assert differing == {"white_balance_temperature_auto": (1, 0)}


def test_parameters_that_are_not_set_are_not_compared():
    assert differing_settings(parse_controls(NEW), wanted_settings({})) == {"auto_exposure": (3, 1)}


def test_missing_tool_and_device_are_reported(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(RobotError, match="v4l2-ctl is not installed"):
        read_controls("/dev/video0")
    tool = tmp_path / "v4l2-ctl"
    tool.write_text("#!/bin/sh\necho 'Cannot open device /dev/video9, exiting.' >&2\nexit 1\n")
    tool.chmod(tool.stat().st_mode | stat.S_IXUSR)
    with pytest.raises(RobotError, match="cannot read /dev/video9: Cannot open device"):
        read_controls("/dev/video9")
    tool.write_text(f"#!/bin/sh\nwhile read line; do echo \"$line\"; done <<'E'\n{OLD}\nE\n")
    assert read_controls("/dev/video0")["exposure_absolute"] == 166
