"""package.xml names the ROS packages that the sources and launch files use."""

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from embodied_active_learning.config import find_profile
from embodied_active_learning.hardware_config import ARMS

ROOT = Path(__file__).resolve().parents[2]


def test_package_xml_names_used_ros_packages():
    manifest = ElementTree.parse(ROOT / "package.xml").getroot()
    named = {element.text for element in manifest if element.tag.endswith("depend")}
    sources = [*(ROOT / "src").rglob("*.py"), *(ROOT / "nodes").iterdir(), *(ROOT / "scripts").glob("*")]
    used = set()
    for path in (path for path in sources if path.is_file()):
        used |= set(re.findall(r"^\s*from (\w+)\.(?:msg|srv) import", path.read_text(), re.MULTILINE))
        used |= set(re.findall(r"^\s*import (rospy|rosbag|actionlib|tf2_ros|cv2)\b", path.read_text(), re.MULTILINE))
    for path in (ROOT / "launch").glob("*.launch"):
        used |= set(re.findall(r'pkg="(\w+)"', path.read_text())) | set(
            re.findall(r"\$\(find (\w+)\)", path.read_text())
        )
    used = {"python3-opencv" if name == "cv2" else name for name in used}
    assert used - named == {manifest.findtext("name")}


def test_library_imports_ros_only_in_its_ros_package():
    """The Python API works where ROS is not installed."""
    package = ROOT / "src" / "embodied_active_learning"
    ros = r"rospy|roslib|rosbag|rosgraph|rosservice|roslaunch|rospkg|genpy|actionlib|tf2_\w+|\w+_msgs|catkin_pkg"
    own = r"embodied_active_learning\.(ros|msg|srv)"
    pattern = re.compile(rf"^\s*(import|from) (({ros})|{own})\b", re.MULTILINE)
    paths = [path for path in package.rglob("*.py") if path.relative_to(package).parts[0] != "ros"]
    assert len(paths) > 100
    assert [str(path) for path in paths if pattern.search(path.read_text(encoding="utf-8"))] == []


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_each_arm_has_node_launch_file_and_profile(arm):
    assert (ROOT / "nodes" / arm.node).is_file()
    assert (ROOT / "launch" / f"{arm.node}.launch").is_file()
    assert not arm.profile or Path(find_profile(arm.profile, ROOT / "config")).is_file()
