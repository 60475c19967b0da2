"""What the README tells to type must work."""

import re
from pathlib import Path
from xml.etree import ElementTree

from embodied_active_learning.simulation.world import load_world
from embodied_active_learning.workspace import Workspace

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_world_in_the_readme_can_be_loaded(tmp_path):
    example = re.search(r"```yaml\n(objects:.*?)```", README, re.DOTALL).group(1)
    picture = next((ROOT / "worlds" / "models" / "table").glob("*.png"))
    path = tmp_path / "example.yaml"
    path.write_text(example.replace("/path/to/picture.png", str(picture)), encoding="utf-8")
    world = load_world(str(path), Workspace())
    assert [item.name for item in world.objects] == ["duck"]
    assert world.disturbances.image_noise == 5.0


def test_every_argument_of_the_launch_file_is_in_the_readme():
    arguments = ElementTree.parse(ROOT / "launch" / "learn.launch").getroot().findall("arg")
    missing = [item.get("name") for item in arguments if not re.search(rf"\b{item.get('name')}:=", README)]
    assert missing == ["device"], "the README tells of every argument but device, which finds the GPU by itself"


def test_every_picture_and_file_that_the_readme_links_to_exists():
    links = re.findall(r"\]\((?!http|#)([^)]+)\)", README)
    assert links
    assert [link for link in links if not (ROOT / link).exists()] == []


def test_every_test_that_is_named_for_a_fault_exists():
    named = re.findall(r"`([\w/]+\.py)::(test_\w+)`", (ROOT / "docs" / "faults.md").read_text(encoding="utf-8"))
    assert len(named) > 50
    sources = {path: (ROOT / "test" / path).read_text(encoding="utf-8") for path, _ in named}
    assert [f"{path}::{name}" for path, name in named if f"def {name}(" not in sources[path]] == []


def test_every_file_that_the_documents_link_to_exists():
    for document in sorted((ROOT / "docs").glob("*.md")):
        links = re.findall(r"\]\((?!http|#)([^)#]+)", document.read_text(encoding="utf-8"))
        assert [link for link in links if not (document.parent / link).exists()] == [], document.name
