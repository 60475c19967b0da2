"""Exposure, focus and white balance of a v4l2 camera: whether the device uses the fixed values of the launch file.

usb_cam 0.3 sets the controls by names that Linux 5.16 has renamed, and only logs a warning if that fails.
"""

from __future__ import annotations

import re
import subprocess
from typing import Any, Dict, List, Mapping, NamedTuple, Tuple

from embodied_active_learning.errors import RobotError

_TIMEOUT = 5.0  # s
_VALUE = re.compile(r"^\s*(\w+) 0x[0-9a-f]+ \(\w+\)\s*:.*\bvalue=(-?\d+)", re.MULTILINE)
_EXPOSURE = ("exposure_time_absolute", "exposure_absolute")
_FOCUS = ("focus_absolute",)
_WHITE_BALANCE = ("white_balance_temperature",)


class Setting(NamedTuple):
    """A control by its names since Linux 5.16 and before, and the value that it should have."""

    names: Tuple[str, ...]
    value: int


def wanted_settings(parameters: Mapping[str, Any]) -> List[Setting]:
    """Return the settings for the parameters of usb_cam: manual modes, and `exposure`, `focus` and `white_balance`."""
    settings = [
        Setting(("auto_exposure", "exposure_auto"), 1),
        Setting(("focus_automatic_continuous", "focus_auto"), 0),
        Setting(("white_balance_automatic", "white_balance_temperature_auto"), 0),
    ]
    for key, control_names in (("exposure", _EXPOSURE), ("focus", _FOCUS), ("white_balance", _WHITE_BALANCE)):
        if key in parameters:
            settings.append(Setting(control_names, int(parameters[key])))
    return settings


def read_controls(device: str) -> Dict[str, int]:
    """Return the values of all controls of a device by name. Raises RobotError."""
    command = ["v4l2-ctl", "--device", device, "--list-ctrls"]
    try:
        output = subprocess.run(command, check=True, capture_output=True, text=True, timeout=_TIMEOUT).stdout
    except FileNotFoundError as error:
        raise RobotError("v4l2-ctl is not installed: sudo apt install v4l-utils") from error
    except (subprocess.SubprocessError, OSError) as error:
        detail = getattr(error, "stderr", None) or error
        raise RobotError(f"v4l2-ctl cannot read {device}: {str(detail).strip()}") from error
    return parse_controls(output)


def parse_controls(output: str) -> Dict[str, int]:
    """Return the values of the controls in the output of `v4l2-ctl --list-ctrls`."""
    return {name: int(value) for name, value in _VALUE.findall(output)}


def differing_settings(controls: Mapping[str, int], settings: List[Setting]) -> Dict[str, Tuple[int, int]]:
    """Return present and wanted value of each control that differs; controls that the camera lacks are skipped."""
    differing = {}
    for setting in settings:
        name = next((name for name in setting.names if name in controls), None)
        if name is not None and controls[name] != setting.value:
            differing[name] = (controls[name], setting.value)
    return differing


def set_command(device: str, differing: Mapping[str, Tuple[int, int]]) -> str:
    """Return the shell command that sets the wanted values; modes first, because they enable the other controls."""
    ordered = sorted(differing, key=lambda name: ("auto" not in name, name))
    return f"v4l2-ctl --device {device} --set-ctrl " + ",".join(f"{name}={differing[name][1]}" for name in ordered)
