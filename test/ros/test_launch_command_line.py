"""Launch arguments that roslaunch does not know are refused, although roslaunch itself ignores them."""

import subprocess

import pytest

from embodied_active_learning.errors import ConfigError
from embodied_active_learning.ros.launch_command_line import check_command_line, check_launch_arguments
from launching import ROOT, environment

LAUNCH = ROOT / "launch"


@pytest.mark.parametrize("name", ["learn", "fingerprint", "identify", "replay", "robot", "two_machines"])
def test_unknown_argument_is_refused(name):
    with pytest.raises(
        ConfigError, match=r"unknown launch argument sesion_root:=: did you mean session_root:=\?|known"
    ):
        check_command_line([str(LAUNCH / f"{name}.launch"), "sesion_root:=/tmp/a"])


def test_similar_argument_is_suggested():
    with pytest.raises(ConfigError, match=r"unknown launch argument worlds:=: did you mean world:=\?"):
        check_command_line(["-p", "11312", "embodied_active_learning", "learn.launch", "seed:=1", "worlds:=diagonal"])


@pytest.mark.parametrize(
    "arguments",
    [
        ["embodied_active_learning", "learn.launch", "world:=right", "__ns:=lab"],
        ["-v", "nowhere.launch", "worlds:=right"],
        [],
    ],
)
def test_known_arguments_and_missing_files_are_left_to_roslaunch(arguments):
    check_command_line(arguments)


def test_file_that_passes_all_arguments_is_not_checked(tmp_path):
    path = tmp_path / "own.launch"
    path.write_text('<launch><include file="x.launch" pass_all_args="true" /></launch>')
    check_command_line([str(path), "anything:=1"])


def test_process_without_roslaunch_is_not_checked():
    check_launch_arguments()


def test_unknown_argument_refused_and_apostrophe_accepted(tmp_path):
    """Dumping parameters parses the launch file like a run does, without a master."""
    root = tmp_path / "o'neill"
    root.mkdir()
    command = ["roslaunch", "--dump-params", "embodied_active_learning", "learn.launch", f"session_root:={root}"]
    options = {"capture_output": True, "text": True, "timeout": 60, "env": environment(tmp_path)}
    accepted = subprocess.run(command, check=False, **options)
    assert str(root) in accepted.stdout.replace("''", "'"), accepted.stderr
    refused = subprocess.run([*command, "step:=100"], check=False, **options)
    assert "unknown launch argument step:=: did you mean steps:=?" in refused.stderr + refused.stdout
