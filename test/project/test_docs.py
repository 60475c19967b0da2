"""Documentation matches the package: links, examples, arguments, interfaces and commands."""

import re
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

import pytest

import embodied_active_learning as eal
from embodied_active_learning.config import Config
from embodied_active_learning.ros import names
from embodied_active_learning.schema import settings
from embodied_active_learning.simulation.world import load_world
from embodied_active_learning.workspace import Workspace

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = {path.name: path.read_text(encoding="utf-8") for path in sorted((ROOT / "docs").glob("*.md"))}
ALL = {"README.md": README, **{f"docs/{name}": text for name, text in PAGES.items()}}


def test_readme_is_short():
    assert len(README.splitlines()) <= 150


@pytest.mark.parametrize("page", ALL)
def test_links_lead_to_existing_files(page):
    links = re.findall(r"\]\((?!http|#)([^)#]+)", ALL[page])
    folder = (ROOT / page).parent
    assert [link for link in links if not (folder / link).exists()] == []


@pytest.mark.parametrize("page", PAGES)
def test_anchors_lead_to_existing_headings(page):
    for target, anchor in re.findall(r"\]\(([\w.]*)#([\w-]+)\)", PAGES[page]):
        headings = re.findall(r"^#+ (.*)$", PAGES[target or page], re.MULTILINE)
        slugs = [re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings]
        assert anchor in slugs


def test_readme_links_to_every_page():
    assert [name for name in PAGES if f"docs/{name}" not in README] == []


def test_example_world_can_be_loaded(tmp_path):
    example = re.search(r"```yaml\n(objects:.*?)```", PAGES["worlds.md"], re.DOTALL).group(1)
    picture = next((ROOT / "worlds" / "models" / "table").glob("*.png"))
    path = tmp_path / "example.yaml"
    path.write_text(example.replace("/path/to/picture.png", str(picture)), encoding="utf-8")
    world = load_world(str(path), Workspace())
    assert [item.name for item in world.objects] == ["duck", "toy"]
    assert world.disturbances.image_noise == 5.0


@pytest.mark.parametrize(
    ("launch", "page"),
    [("learn", "quickstart.md"), ("identify", "fingerprints.md"), ("replay", "record_replay.md")],
)
def test_launch_arguments_are_documented(launch, page):
    arguments = ElementTree.parse(ROOT / "launch" / f"{launch}.launch").getroot().findall("arg")
    arguments = [item for item in arguments if item.get("value") is None]
    text = PAGES[page] + PAGES["quickstart.md"]
    assert [item.get("name") for item in arguments if not re.search(rf"\b{item.get('name')}:=", text)] == []


def test_interfaces_are_documented():
    """Topics and services of this package appear in the page on nodes."""
    own = [value for name, value in vars(names).items() if name.isupper() and isinstance(value, str)]
    foreign = (
        "usb_cam",
        "franka",
        "controller_manager",
        "cartesian",
        "~",
        "panda",
        "camera_optical",
        "config",
        "failure",
    )
    topics = [value for value in own if not value.startswith(foreign)]
    assert [topic for topic in topics if topic not in PAGES["nodes.md"] + PAGES["record_replay.md"]] == []


def test_named_parameters_exist():
    """Parameters written as `section/key` exist in the configuration."""
    known = {f"{section}/{item.name}" for section, item in settings(Config)}
    sections = {key.split("/")[0] for key in known}
    for page, text in ALL.items():
        named = re.findall(r"`([a-z_]+/[a-z_]+)`", text)
        assert [key for key in named if key.split("/")[0] in sections and key not in known] == [], page


def test_named_modules_exist():
    """Modules written as `folder/module.py` exist in the library or the repository."""
    library = ROOT / "src" / "embodied_active_learning"
    for page, text in ALL.items():
        paths = re.findall(r"`((?:[\w]+/)+\w+\.(?:py|c))`", text)
        assert [path for path in paths if not (library / path).exists() and not (ROOT / path).exists()] == [], page


def test_commands_start_existing_modules():
    scripts = [path for folder in ("tools", "experiments", "examples") for path in (ROOT / folder).glob("*.*")]
    texts = [*ALL.values(), *(path.read_text(encoding="utf-8") for path in scripts)]
    modules = {name for text in texts for name in re.findall(r"-m (embodied_active_learning[\w.]*\w)", text)}
    assert [name for name in sorted(modules) if find_spec(name) is None] == []
    assert "embodied_active_learning.sweep" in modules


def test_named_public_functions_exist():
    """Functions called as eal.name in the README are in the public API."""
    assert [name for name in re.findall(r"\beal\.(\w+)", README) if not hasattr(eal, name)] == []
