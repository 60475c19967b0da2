"""Generated messages of franka_ros have the checksums of the originals."""

import importlib
import re

import pytest

from fake_franka.generate import generate

# Found in code that others generated from the originals: C++ of franka_msgs 0.10 (messages, and the request of
# SetFullCollisionBehavior, from which that service's follows), JavaScript of franka_control (the other service, whose
# fields have not changed since) and of ros_control 0.19, and C# of dynamic_reconfigure 1.7.
ORIGINALS = {
    "franka_msgs.msg.FrankaState": "431567d5df6caf4e4dd7385f25cb71ee",
    "franka_msgs.msg.Errors": "082e9a670c96d8bc64b53e32777458e7",
    "franka_msgs.msg.ErrorRecoveryAction": "d5a016b49f278075666fbc901debbd08",
    "franka_msgs.srv.SetLoad": "c9a8ec436164dd9cbc1e5e137d358e0b",
    "franka_msgs.srv.SetFullCollisionBehavior": "c6fef9a8ad446db9a39cca3b7bc200d8",
    "franka_msgs.srv.SetFullCollisionBehaviorRequest": "bc875909c147220ba1720adcd48e47ea",
    "franka_msgs.srv.SetFullCollisionBehaviorResponse": "45872d25d65c97743cc71afc6d4e884d",
    "controller_manager_msgs.msg.ControllerState": "aeb6b261d97793ab74099a3740245272",
    "controller_manager_msgs.srv.ListControllers": "1341feb2e63fa791f855565d0da950d8",
    "controller_manager_msgs.srv.LoadController": "647e5c54b8d6468952d8d31f1efe96c0",
    "controller_manager_msgs.srv.UnloadController": "647e5c54b8d6468952d8d31f1efe96c0",
    "controller_manager_msgs.srv.SwitchController": "b29a7abc673b2c54c14b54e50f8d06a5",
    "dynamic_reconfigure.srv.Reconfigure": "bb125d226a21982a4a98760418dc2672",
}


@pytest.fixture(scope="module")
def generated(tmp_path_factory):
    """Yield the folder of the modules and the generated packages."""
    folder = tmp_path_factory.mktemp("messages")
    return folder, generate(folder)


def checksum(generated, name):
    folder, packages = generated
    package, kind, name = name.split(".")
    if package not in packages:
        return getattr(importlib.import_module(f"{package}.{kind}"), name)._md5sum
    module = re.sub("(Request|Response)$", "", name) if kind == "srv" else name
    text = (folder / package / kind / f"_{module}.py").read_text()
    return re.search(rf'^class {name}\(.*?_md5sum\s+= [\'"](\w+)', text, re.MULTILINE | re.DOTALL)[1]


@pytest.mark.parametrize("name", sorted(ORIGINALS))
def test_checksum_of_the_original(generated, name):
    assert checksum(generated, name) == ORIGINALS[name]


def test_only_outdated_modules_are_generated(generated):
    folder, packages = generated
    for package in packages:
        stamp = folder / package / ".version"
        marker = folder / package / "msg" / "marker"
        marker.touch()
        generate(folder)
        assert marker.exists()
        stamp.write_text("of another description")
        generate(folder)
        assert not marker.exists()
